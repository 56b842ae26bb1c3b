"""When the images of a folder were taken, and in which order, as people and programs name them."""

from __future__ import annotations

import random
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import cv2
import pytest

from airline.errors import InputError
from frontend.sources import open_source
from frontend.sources.folder import FolderSource
from tests.helpers.numbered import number_of, numbered, write_numbered

START = 1560004885
FPS_NOTE = "numbered by 30 frames/s: --fps"


def read(spec: object) -> tuple[list[int], list[int], FolderSource]:
    """Numbers in the pictures, stamps in ns, and the source."""
    source = open_source(str(spec))
    assert isinstance(source, FolderSource)
    frames = list(source)
    assert source.frame_count == len(frames)
    assert [frame.index for frame in frames] == list(range(len(frames)))
    assert (source.first_stamp_ns, source.last_stamp_ns) == (frames[0].stamp_ns, frames[-1].stamp_ns)
    return [number_of(frame.image) for frame in frames], [frame.stamp_ns for frame in frames], source


def said(source: FolderSource, words: str) -> bool:
    return sum(words in note for note in source.notes) == 1


def seconds(number: int) -> Decimal:
    return Decimal(START) + Decimal(number) * Decimal("0.0625")


NAMES = {  # how a time in seconds is written, and the words for it
    "s": (lambda t: f"{START + int((t - START) * 16)}", "seconds"),
    "ms": (lambda t: f"{int(t * 1000)}", "milliseconds"),
    "us": (lambda t: f"{int(t * 10**6)}", "microseconds"),
    "us after words": (lambda t: f"cam0_frame_{int(t * 10**6)}", "microseconds"),
    "us after a counter": (lambda t: f"{int((t - START) * 16):06d}-{int(t * 10**6)}", "microseconds"),
    "us before words": (lambda t: f"{int(t * 10**6)}.color", "microseconds"),
    "decimal": (lambda t: f"{t:.6f}", "decimal seconds"),
    "trailing zeros lost": (lambda t: f"{float(t)}", "decimal seconds"),
    "whole seconds without a point": (lambda t: f"{float(t):.16g}", "decimal seconds"),
    "decimal after words": (lambda t: f"frame_{t:.6f}", "decimal seconds"),
    "decimal after a word of cameras": (lambda t: f"image_{t - START:.6f}", "decimal seconds"),
    "decimal after a number": (lambda t: f"cam0_{t:.6f}", "decimal seconds"),
    "pair": (lambda t: f"{int(t)}_{int(t % 1 * 10**9):09d}", "seconds and their fractions"),
    "pair of s and us": (lambda t: f"{int(t)}-{int(t % 1 * 10**6):06d}", "seconds and their fractions"),
    "pair without zeros": (lambda t: f"{int(t)}_{int(t % 1 * 10**9)}", "seconds and nanoseconds"),
    "date": (lambda t: f"2019-06-08T14-41-{int(t) - START + 25:02d}.{int(t % 1 * 10**6):06d}", "dates"),
    "compact date": (lambda t: f"20190608_1441{int(t) - START + 25:02d}_{int(t % 1 * 10**9):09d}", "dates"),
}

MOMENT = datetime(2021, 6, 8, 12, 59, 58, 500_000)
CLOCKS: dict[str, Callable[[datetime], str]] = {  # how the 0.25 s steps around one o'clock are written
    "two digits": lambda d: f"{d:%Y-%m-%d_%H-%M-%S}.{d.microsecond // 10_000:02d}",
    "seven digits": lambda d: f"{d:%Y-%m-%dT%H-%M-%S.%f}0Z",
    "zeros lost": lambda d: f"{d:%Y-%m-%d %H.%M.%S.%f}".rstrip("0").rstrip("."),
    "comma": lambda d: f"{d:%Y%m%d_%H%M%S},{d.microsecond // 10_000:02d}",
    "letters": lambda d: f"vlcsnap-{d:%Y-%m-%d-%Hh%Mm%S}s{d.microsecond // 1000:03d}",
    "words": lambda d: f"Screenshot {d:%Y-%m-%d at %H.%M.%S.%f}",
    "offset": lambda d: f"{d:%Y-%m-%dT%H-%M-%S.%f}+0200",
}


@pytest.mark.parametrize("form", CLOCKS)
def test_dates_and_clocks_in_names(tmp_path: Path, form: str) -> None:
    write_numbered(tmp_path, [f"{CLOCKS[form](MOMENT + timedelta(seconds=k / 4))}.png" for k in range(12)])
    numbers, stamps, source = read(tmp_path)
    assert numbers == list(range(12))
    assert [stamp - stamps[0] for stamp in stamps] == [k * 10**9 // 4 for k in range(12)]
    assert said(source, "taken for dates by")
    assert stamps[0] == int(MOMENT.replace(tzinfo=UTC).timestamp() * 10) * 10**8


def test_one_digit_of_a_second(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"2019-06-08T14-41-{k // 10}.{k % 10}.png".replace("-41-", "-41-5") for k in range(95)])
    assert read(tmp_path)[1][-1] - read(tmp_path)[1][0] == 9_400_000_000


@pytest.mark.parametrize("unit", [10**6, 10**9])
def test_seconds_and_their_parts_without_zeros(tmp_path: Path, unit: int) -> None:
    """A part of 33 ms is printed as .33, as one of 330 ms is: only one of the two makes even steps."""
    stamps = [START * unit + unit * 9 // 10 + k * unit // 30 for k in range(10)]
    write_numbered(tmp_path, [f"{stamp // unit}.{stamp % unit}.png" for stamp in stamps])
    numbers, read_, source = read(tmp_path)
    assert (numbers, read_) == (list(range(10)), [stamp * (10**9 // unit) for stamp in stamps])
    assert said(source, f"seconds and {'micro' if unit == 10**6 else 'nano'}seconds")


def test_milliseconds_with_decimals(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"_Color_{START * 1000 + 40 * k}.165039.png" for k in range(4)])
    numbers, stamps, source = read(tmp_path)
    assert (numbers, stamps) == ([0, 1, 2, 3], [START * 10**9 + 40_000_000 * k + 165_039 for k in range(4)])
    assert said(source, "decimal milliseconds")


@pytest.mark.parametrize("form", NAMES)
def test_times_in_names(tmp_path: Path, form: str) -> None:
    name, words = NAMES[form]
    step = 1 if form == "s" else 1 / 16
    whole = 1000 if form == "ms" else 10**9
    expected = [int((START + Decimal(step) * k) * whole) * (10**9 // whole) for k in range(40)]
    write_numbered(tmp_path, [f"{name(seconds(k))}.png" for k in range(40)])
    numbers, stamps, source = read(tmp_path)
    assert numbers == list(range(40))
    assert [stamp - stamps[0] + expected[0] for stamp in stamps] == expected
    assert stamps[0] in (expected[0], 0)
    assert said(source, f"taken for {words} by")
    assert source.kind == "images named by their time"
    assert not said(source, FPS_NOTE)


def test_nanoseconds_are_nothing_to_note(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"{START * 10**9 + 123 + k}.png" for k in (0, 62_500_000, 125_000_001)])
    assert read(tmp_path)[1] == [START * 10**9 + 123 + k for k in (0, 62_500_000, 125_000_001)]
    assert read(tmp_path)[2].notes == []


def test_values_order_names_that_programs_print(tmp_path: Path) -> None:
    texts = ["02.0", "02.075", "02.15", "02.225", "02.3", "02.375", "10.5", "10.55"]
    write_numbered(tmp_path, [f"{text}.png" for text in texts])
    numbers, stamps, source = read(tmp_path)
    assert numbers == list(range(8))
    assert stamps == [int(Decimal(text) * 10**9) for text in texts]
    assert said(source, "order of their times")
    assert read(tmp_path / "*.png")[:2] == (numbers, stamps)


@pytest.mark.parametrize(
    "names",
    [
        [f"{k:06d}" for k in range(12)],
        [f"{k}" for k in range(95, 107)],
        [f"shot01.{k:04d}" for k in range(12)],  # renderers
        [f"1.{k}" for k in range(1, 13)],
        [f"{START}_{k:06d}" for k in range(12)],  # when the recording began, and a counter
        [f"{START}_{k}" for k in range(12)],
        [f"20190608_144125_{k:03d}" for k in range(12)],
        [f"20190608_14412{k // 5}_{k % 5:03d}" for k in range(12)],  # a counter in each second
        [f"{START + k // 5}-{k % 5:03d}" for k in range(12)],
        [f"fc2_save_2019-06-08-14412{k // 5}-{k:04d}" for k in range(12)],
        ["2021-06-08 14.41.20", *(f"2021-06-08 14.41.20-{k}" for k in range(1, 12))],
        [f"2019-06-08 {k}" for k in range(12)],
        [f"{START * 1000}_{k}" for k in range(12)],
        [f"{k:010d}" for k in range(12)],
        [f"{700 + k}x480" for k in range(12)],
        [f"14_41_{25 + k}.50" for k in range(12)],  # of a clock
        [f"clip_41-{25 + k}.500" for k in range(12)],
        [f"2019-06-08 02-41-{25 + k} PM" for k in range(12)],  # of twelve hours
    ],
)
def test_counters_are_no_times(tmp_path: Path, names: list[str]) -> None:
    write_numbered(tmp_path, [f"{name}.png" for name in names])
    numbers, stamps, source = read(tmp_path)
    assert numbers == list(range(12))
    assert stamps == [round(k * 1e9 / 30) for k in range(12)]
    assert source.kind == "images"
    assert said(source, FPS_NOTE)


def test_the_rate_that_is_given_is_said(tmp_path: Path) -> None:
    write_numbered(tmp_path, ["a.png", "b.png"])
    source = FolderSource(tmp_path, fps=12.5)
    assert source.notes == ["images without times are numbered by 12.5 frames/s: --fps gives another rate"]
    assert FolderSource(tmp_path / "a.png").notes == []


def test_odd_files_among_stamps_are_left_out_and_named(tmp_path: Path) -> None:
    names = [f"{START * 10**6 + k * 62_500}.png" for k in range(20)]
    write_numbered(tmp_path, [*names, "thumb.jpg", "12.png"])
    numbers, stamps, source = read(tmp_path)
    assert numbers == list(range(20))
    assert stamps[1] - stamps[0] == 62_500_000
    assert said(source, "left out of 22 images for want of a time in the name: '12.png', 'thumb.jpg'")


def test_equal_times_are_refused(tmp_path: Path) -> None:
    write_numbered(tmp_path, ["1.50.png", "1.5.png", "1.6.png"])
    with pytest.raises(InputError, match=r"'1\.5\.png' and '1\.50\.png' of .* have the same time"):
        open_source(tmp_path)


def test_two_cameras_in_one_folder(tmp_path: Path) -> None:
    """Of pictures of the same moments the first camera's are taken; of other moments they would be mixed."""
    for folder, late in (("same", 0), ("other", 7)):
        names = [f"cam{c}_{START * 1000 + 20 * k + late * c}.png" for c in (0, 1) for k in range(3)]
        write_numbered(tmp_path / folder, names)
    numbers, _, source = read(tmp_path / "same")
    assert numbers == [0, 1, 2]
    assert said(source, "3 like 'cam1_1560004885000.png' are left out: a glob pattern chooses others")
    with pytest.raises(InputError, match=r"several cameras .*cam0_\*.*by a glob") as caught:
        open_source(tmp_path / "other")
    assert "\n" not in str(caught.value)
    for folder in ("same", "other"):
        assert read(tmp_path / folder / "cam1*")[0] == [3, 4, 5]


TABLES = {  # name, rows, with the stamps of 0.1 s steps
    "color.txt": lambda k, t: f"{t} color/{k}.png",
    "images.txt": lambda k, t: f"{t},color/{k}.png",
    "stamps.csv": lambda k, t: f"{k}.png;{t}",
    "frames.txt": lambda k, t: f"{int(t * 10**6)} {k}.png",
    "associations.txt": lambda k, t: f"{t + Decimal('0.01')} depth/{k}.png {t} color/{k}.png",
}


OTHER_TABLES = {  # of images 0000.png and so on in "images", with the stamps of 0.1 s steps
    "frames.csv": ["frame,ts", "{k},{t}"],
    "stems.csv": ["{k:04d},{t}"],
    "quoted.csv": ['"name","time"', '"{k:04d}.png","{t}"'],
    "far.csv": ["/home/me/images/{k:04d}.png,{t}"],
    "drive.csv": ["C:\\images\\{k:04d}.png;{t}"],
    "date.csv": ["{k:04d}.png,{date}Z"],
    "date.txt": ["{date} {k:04d}.png"],
    "zone.csv": ["{date}+00:00\t{k:04d}.png"],
    "after.csv": ["name,exposure_time_ms,stamp", "{k:04d}.png,10.{k},{t}"],
    "gains.csv": ["{k:04d}.png,{k}.5,{us},10.5"],
    "../timestamps.txt": ["{date}"],
    "../times.csv": ["time", "{t}"],
    "../times.txt": ["{k} 0.01{k} {t}"],
    "timestamps.txt": ["frame exposure time", "{k} 0.01{k} {t}"],
}


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("table", OTHER_TABLES)
def test_the_column_of_times(tmp_path: Path, table: str, backwards: bool) -> None:
    folder = tmp_path / "images"
    write_numbered(folder, [f"{k:04d}.png" for k in range(8)])
    *heading, row = OTHER_TABLES[table]
    rows = [row.format(k=k, t=f"{START}.{k}", us=f"{START}{k}00000", date=f"2019-06-08 14:41:25.{k}") for k in range(8)]
    if backwards and "{k" in row:
        rows.reverse()
    (folder / table).write_text("\n".join([*heading, *rows]))
    numbers, stamps, source = read(folder)
    assert numbers == list(range(8))
    assert stamps[0] // 10**9 in (START, int(datetime(2019, 6, 8, 14, 41, 25, tzinfo=UTC).timestamp()))
    assert [stamp - stamps[0] for stamp in stamps] == [k * 10**8 for k in range(8)]
    assert f"'{Path(table).name}'" in source.kind or source.kind == "KITTI sequence"


def test_pictures_of_formats_that_are_not_read_are_said(tmp_path: Path) -> None:
    write_numbered(tmp_path, ["thumb.jpg"])
    for k in range(5):
        (tmp_path / f"{k}.JP2").touch()
    assert said(read(tmp_path)[2], "left out for their format: '0.JP2', '1.JP2', '2.JP2' and 2 more")


def test_the_unit_of_a_heading(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"{k:04d}.png" for k in range(8)])
    (tmp_path / "index.csv").write_text("file;time [ms]\n" + "".join(f"{k:04d}.png;{40 * k}\n" for k in range(8)))
    assert read(tmp_path)[1] == [40_000_000 * k for k in range(8)]


@pytest.mark.parametrize(
    "rows",
    [
        ["{k:04d}.png,47.10{k},8.10{k},40{k}"],
        ["name,lat,lon", "{k:04d}.png,47.10{k},8.10{k}"],
        ["{k:04d}.png 1.0{k} 2.0{k} 3"],
        ["{k} 0.5 0.5 0.1{k} 0.1"],
        ["{k:04d}.png,0.{other}"],
        ["{k:04d}.png {k}"],
        ["frame,x", "{k},5.{k}"],
        ["time,objects", "1.{k},{half}"],
        ["{other}th,5.{k}"],
        ["\n".join(f"0.{n:02d} {n % 8} {n % 3} 1" for n in range(40)) + "\n0.9{k} {k} 1 1"],  # events
    ],
)
def test_places_and_scores_are_no_times(tmp_path: Path, rows: list[str]) -> None:
    write_numbered(tmp_path, [f"{k:04d}.png" for k in range(8)])
    text = "\n".join([*rows[:-1], *(rows[-1].format(k=k, other=k * 5 % 8, half=k // 2) for k in range(8))])
    (tmp_path / "numbers.csv").write_text(text)
    assert said(read(tmp_path)[2], FPS_NOTE)


def test_times_above_that_are_of_other_images(tmp_path: Path) -> None:
    write_numbered(tmp_path / "images", [f"{k:04d}.png" for k in range(8)])
    (tmp_path / "timestamps.txt").write_text("1\n2\n3\n")
    source = read(tmp_path / "images")[2]
    assert said(source, "times above are not taken: ")
    assert said(source, FPS_NOTE)


def test_a_folders_own_times_come_first(tmp_path: Path) -> None:
    write_numbered(tmp_path / "images", [f"{k:04d}.png" for k in range(8)])
    for table, step_s in (("times.txt", 0.5), ("timestamps.txt", 0.5), ("images/times.csv", 0.1)):
        (tmp_path / table).write_text("\n".join(f"{START + step_s * k:.1f}" for k in range(8)))
    assert read(tmp_path / "images")[1] == [START * 10**9 + k * 10**8 for k in range(8)]


def test_tables_that_disagree_are_told(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"{k}.png" for k in range(8)])
    for table, name in (("a.csv", "/home/me/{k}.jpg"), ("b.csv", "{k}.png")):  # converted, on another machine
        rows = [f"{name.format(k=k)},{START * 10 + (k if table == 'a.csv' else 2 * k)}00000" for k in range(8)]
        (tmp_path / table).write_text("\n".join(rows))
    numbers, stamps, source = read(tmp_path)
    assert (numbers, stamps) == (list(range(8)), [(START * 10 + k) * 10**8 for k in range(8)])
    assert said(source, "'b.csv' has other times than 'a.csv', which is taken")


@pytest.mark.parametrize("times", ["{ns} 0.01{k}", "{ns},{k}"])
def test_exposure_beside_names_that_are_times(tmp_path: Path, times: str) -> None:
    stamps = [START * 10**9 + k * 10**8 + 7 for k in range(8)]
    write_numbered(tmp_path, [f"{stamp}.png" for stamp in stamps])
    (tmp_path / "times.txt").write_text("\n".join(times.format(ns=stamp, k=k) for k, stamp in enumerate(stamps)))
    assert read(tmp_path)[:2] == (list(range(8)), stamps)


def test_a_column_of_times_that_cannot_be_told_is_said(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"{k:04d}.png" for k in range(8)])
    (tmp_path / "times.txt").write_text("".join(f"{k} {k / 10} 0.01\n" for k in range(8)))
    numbers, stamps, source = read(tmp_path)
    assert (numbers, stamps[3]) == (list(range(8)), 300_000_000)
    assert said(source, "of the numbers of 'times.txt' those in column 2 are taken for times")


@pytest.mark.parametrize(
    ("table", "row"),
    [
        ("data.csv", "{ns} {name}"),
        ("data.csv", "{ns}\t{name}"),
        ("data.csv", '"{ns}" ; "{name}"'),
        ("data.csv", "{ns}, {name}, 0.01"),
        ("data.csv", "{ns} {name} 0.01"),
        ("rgb.txt", "{t},{name}"),
        ("rgb.txt", "{t} {name} 0.01"),
    ],
)
@pytest.mark.parametrize("name", ["{k:03d}.png", "a picture {k:03d}.png"])
def test_known_tables_as_other_programs_write_them(tmp_path: Path, table: str, row: str, name: str) -> None:
    names = [name.format(k=k) for k in range(6)]
    if "a" in name[:1] and row.endswith("} 0.01"):
        return  # blanks in a name are no longer told from those between columns
    write_numbered(tmp_path / "data" if table == "data.csv" else tmp_path, names)
    rows = [row.format(ns=(START * 10 + k) * 10**8, t=f"{START}.{k}", name=name) for k, name in enumerate(names)]
    (tmp_path / table).write_text("\n".join(rows))
    numbers, stamps, _ = read(tmp_path)
    assert (numbers, stamps) == (list(range(6)), [(START * 10 + k) * 10**8 for k in range(6)])


@pytest.mark.parametrize("given", ["color", ""])
@pytest.mark.parametrize("table", TABLES)
def test_tables_of_any_name(tmp_path: Path, table: str, given: str) -> None:
    times = [Decimal(START) + Decimal(k) / 10 for k in range(12)]
    write_numbered(tmp_path / "color", [f"{k}.png" for k in range(12)])
    write_numbered(tmp_path / "depth", [f"{k}.png" for k in range(12)])
    lines = [TABLES[table](k, t) for k, t in enumerate(times)]
    (tmp_path / table).write_text("\n".join(["# heading", *lines]))
    (tmp_path / "depth.txt").write_text("\n".join(f"{t} depth/{k}.png" for k, t in enumerate(times)))
    (tmp_path / "classes.txt").write_text("\n".join(f"color/{k}.png {k}" for k in range(12)))
    if not given and "color/" not in lines[0]:
        return
    numbers, stamps, source = read(tmp_path / given)
    assert numbers == list(range(12))
    assert stamps == [int(t * 10**9) for t in times]
    assert source.kind == f"images with times in '{table}'"
    assert said(source, f"times are from '{table}'")


@pytest.mark.parametrize(
    "names",
    [
        ["x0", "x0(0)", "x0-1", *(f"x{k}" for k in range(1, 10))],
    ],
)
def test_numbers_in_names_order_images(tmp_path: Path, names: list[str]) -> None:
    write_numbered(tmp_path, [f"{name}.jpg" for name in names])
    assert read(tmp_path)[0] == list(range(12))
    assert read(tmp_path / "*.jpg")[0] == list(range(12))


def test_a_table_that_lists_fewer_images(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"{k}.png" for k in range(12)])
    (tmp_path / "list.txt").write_text("\n".join(f"{START + k / 4} {k}.png" for k in range(1, 11)))
    numbers, stamps, source = read(tmp_path)
    assert numbers == list(range(1, 11))
    assert stamps[1] - stamps[0] == 250_000_000
    assert said(source, "left out of 12 images for want of a time in 'list.txt': 2")
    (tmp_path / "list.txt").write_text("1560004885.5 1.png\n")
    assert len(read(tmp_path)[0]) == 12


@pytest.mark.parametrize("given", ["image_00/data", "image_00", ""])
@pytest.mark.parametrize("cameras", [["image_00"], ["image_00", "image_01", "image_02"]])
def test_kitti_raw(tmp_path: Path, given: str, cameras: list[str]) -> None:
    for camera in cameras:
        write_numbered(tmp_path / camera / "data", [f"{k:010d}.png" for k in range(12)], grey=camera < "image_02")
        lines = [f"2011-09-26 13:02:2{5 + k // 10}.{k % 10}64389445\n" for k in range(12)]
        (tmp_path / camera / "timestamps.txt").write_text("".join(lines))
    numbers, stamps, source = read(tmp_path / given)
    assert numbers == list(range(12))
    assert stamps == [1317042145_064389445 + k * 10**8 for k in range(12)]
    assert source.kind == "KITTI sequence"
    assert said(source, "image_00, image_01") == (not given and len(cameras) > 1)


def test_kitti_raw_with_images_missing(tmp_path: Path) -> None:
    write_numbered(tmp_path / "data", [f"{k:010d}.png" for k in (0, 1, 4, 5)])
    lines = [f"2011-09-26 13:02:25.{k}64389445\n" for k in range(6)]
    (tmp_path / "timestamps.txt").write_text("".join(lines))
    _, stamps, source = read(tmp_path / "data")
    assert [(stamp - stamps[0]) // 10**8 for stamp in stamps] == [0, 1, 4, 5]
    assert said(source, "6 times for 4 images")


@pytest.mark.parametrize("row", ["{id:05d} {t} 0.0132", "{id:05d}\t{t}", "{id},{t},0.01", "{id} {t:.0f}e0 1"])
@pytest.mark.parametrize("named", [True, False])
def test_times_with_ids(tmp_path: Path, row: str, named: bool) -> None:
    first = 100
    write_numbered(tmp_path / "images", [f"{first + k:05d}.jpg" if named else f"{'abcdefgh'[k]}.jpg" for k in range(8)])
    step = 1 if ":.0f" in row else 0.05
    lines = [row.format(id=first + k, t=START + k * step) for k in range(8)]
    (tmp_path / "times.txt").write_text("\n".join(["id stamp exposure", *lines]))
    numbers, stamps, _ = read(tmp_path / "images")
    assert numbers == list(range(8))
    assert stamps == [START * 10**9 + round(k * step * 1000) * 10**6 for k in range(8)]


def test_ids_choose_the_times_of_images_that_are_left(tmp_path: Path) -> None:
    write_numbered(tmp_path, ["00002.png", "00003.png", "00007.png"])
    (tmp_path / "times.txt").write_text("".join(f"{k:05d} {START + k / 20} 0.01\n" for k in range(9)))
    _, stamps, source = read(tmp_path)
    assert [stamp - START * 10**9 for stamp in stamps] == [100_000_000, 150_000_000, 350_000_000]
    assert said(source, "9 times for 3 images: each takes that of its id")


@pytest.mark.parametrize(
    ("table", "unit", "row"), [("data.csv", 10**6, "{},{}"), ("rgb.txt", 10**9, "{} {}"), ("times.txt", 10**6, "{}")]
)
def test_known_tables_in_other_units(tmp_path: Path, table: str, unit: int, row: str) -> None:
    names = [f"{k:03d}.png" for k in range(6)]
    write_numbered(tmp_path / "data" if table == "data.csv" else tmp_path, names)
    lines = [row.format(START * unit + k * unit // 16, name) for k, name in enumerate(names)]
    (tmp_path / table).write_text("\n".join(lines))
    numbers, stamps, source = read(tmp_path)
    assert numbers == list(range(6))
    assert stamps == [START * 10**9 + k * 62_500_000 for k in range(6)]
    assert said(source, f"the times of '{table}' are taken for {'micro' if unit == 10**6 else 'nano'}seconds")


@pytest.mark.parametrize(
    ("pattern", "names", "expected"),
    [
        ("%06d.png", [f"{k:06d}.png" for k in range(12)], list(range(12))),
        ("img_%04d.png", [f"img_{k:04d}.png" for k in range(12)], list(range(12))),
        ("%d.png", [f"{k}.png" for k in range(12)], list(range(12))),
        ("####.png", [f"{k:04d}.png" for k in range(12)], list(range(12))),
        ("[x]%03d.png", [f"[x]{k:03d}.png" for k in range(12)], list(range(12))),
        ("%03d.png", ["000.png", "x01.png", "2.png", "003.png", "1000.png", "003.jpg"], [0, 3, 4]),
    ],
)
def test_number_patterns(tmp_path: Path, pattern: str, names: list[str], expected: list[int]) -> None:
    write_numbered(tmp_path, names)
    assert read(tmp_path / pattern)[0] == expected
    with pytest.raises(InputError, match="no image matches"):
        open_source(tmp_path / "none" / pattern)


def test_a_folder_of_recordings_is_told(tmp_path: Path) -> None:
    for suffix in ("mcap", "mp4"):
        folder = tmp_path / suffix
        folder.mkdir()
        (folder / f"b.{suffix}").touch()
        with pytest.raises(InputError, match=rf"name one, such as 'b\.{suffix}'$"):
            FolderSource(folder)
        (folder / f"a.{suffix}").touch()
        with pytest.raises(
            InputError, match=rf"'a\.{suffix}', or all of them to python -m frontend\.batch: '.*\*\.{suffix}'"
        ):
            FolderSource(folder)


def test_shuffled_names_come_in_the_order_of_their_times(tmp_path: Path) -> None:
    """A counter that has nothing to do with the times, as object stores and threads of writers leave."""
    order = list(range(20))
    random.Random(1).shuffle(order)
    names = [f"{order[k]:03d}_{START * 1000 + 40 * k}.png" for k in range(20)]
    write_numbered(tmp_path, names)
    numbers, stamps, source = read(tmp_path)
    assert numbers == list(range(20))
    assert {b - a for a, b in pairwise(stamps)} == {40_000_000}
    assert said(source, "order of their times")


def test_the_picture_helper_tells_numbers_and_up() -> None:
    assert [number_of(numbered(k)) for k in range(256)] == list(range(256))
    with pytest.raises(AssertionError):
        number_of(cv2.rotate(numbered(3), cv2.ROTATE_180))


def test_times_in_milliseconds_where_seconds_belong_are_doubted(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"{number:06d}.png" for number in range(4)])
    (tmp_path / "times.txt").write_text("0\n100\n200\n300\n")
    numbers, stamps, source = read(tmp_path)
    assert (numbers, stamps[1]) == ([0, 1, 2, 3], 100 * 10**9)
    assert said(source, "images are 100 s apart by their times: correct these if that is another unit")


def test_times_below_zero_are_counted_from_the_first(tmp_path: Path) -> None:
    for word in ("", "frame_"):
        write_numbered(tmp_path / f"x{word}", [f"{word}{number / 10}.png" for number in range(-3, 3)])
        numbers, stamps, source = read(tmp_path / f"x{word}")
        assert (numbers, stamps) == (list(range(6)), [number * 10**8 for number in range(6)])
        assert said(source, "times begin below zero, at -0.3 s, and are counted from there")

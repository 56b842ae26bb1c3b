"""Folders of images: plain ones and the layouts of well-known data sets."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from airline.errors import ConfigError, InputError
from frontend.sources import open_source
from frontend.sources.folder import FolderSource


def drawn(number: int) -> np.ndarray:
    image = np.full((24, 32, 3), 60, np.uint8)
    image[:, : number + 1] = (250, number, 10)
    return image


def write(folder: Path, names: list[str]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(folder / name), drawn(number))
    return folder


def stamps(spec: Path) -> list[int]:
    return [frame.stamp_ns for frame in open_source(spec)]


@pytest.mark.parametrize("suffix", ["png", "bmp", "tif", "tiff", "ppm", "PNG", "jpg", "jpeg", "webp"])
def test_natural_order_and_frame_rate(tmp_path: Path, suffix: str) -> None:
    write(tmp_path, [f"img{number}.{suffix}" for number in range(12)])
    (tmp_path / "notes.txt").write_text("no image")
    (tmp_path / f"._img3.{suffix}").write_bytes(b"what macOS leaves behind")
    (tmp_path / f"folder.{suffix}").mkdir()
    source = FolderSource(tmp_path, fps=3)
    assert source.frame_count == 12
    frames = list(source)
    assert [frame.index for frame in frames] == list(range(12))
    assert [frame.stamp_ns for frame in frames] == [round(number * 1e9 / 3) for number in range(12)]
    for number, frame in enumerate(frames):
        assert frame.image.flags.c_contiguous
        if suffix in ("jpg", "jpeg", "webp"):
            assert np.abs(frame.image[:, 16:].astype(int) - drawn(number)[:, 16:]).max() < 30
        else:
            np.testing.assert_array_equal(frame.image, drawn(number))


def test_depth_and_channels_are_kept(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    images = {
        "0.png": rng.integers(0, 2**16, (5, 7), np.uint16),
        "1.png": rng.integers(0, 256, (5, 7), np.uint8),
        "2.pgm": rng.integers(0, 2**16, (5, 7), np.uint16),
        "3.png": rng.integers(0, 256, (5, 7, 4), np.uint8),
        "4.tif": rng.integers(0, 2**16, (9, 3, 3), np.uint16),
        "5.tif": rng.random((5, 7), np.float32),
    }
    for name, image in images.items():
        assert cv2.imwrite(str(tmp_path / name), image)
    source = FolderSource(tmp_path)
    frames = list(source)
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]
    assert source.skipped == 1  # float is no image for a Frame
    for frame, image in zip(frames, images.values(), strict=False):
        expected = image[:, :, :3] if image.ndim == 3 else image
        assert frame.image.dtype == expected.dtype
        np.testing.assert_array_equal(frame.image, expected)


@pytest.mark.parametrize("given", ["", "mav0", "mav0/cam0", "mav0/cam0/data"])
@pytest.mark.parametrize("table", [True, False])
def test_euroc(tmp_path: Path, given: str, table: bool) -> None:
    times = [1403636579763555584, 1403636579813555456, 1403636579863555584]
    write(tmp_path / "mav0" / "cam0" / "data", [f"{time}.png" for time in times])
    if table:
        rows = "".join(f"{time + 1},{time}.png\r\n" for time in times)
        (tmp_path / "mav0" / "cam0" / "data.csv").write_text("#timestamp [ns],filename\r\n" + rows)
    assert stamps(tmp_path / given) == [time + table for time in times]


@pytest.mark.parametrize("given", ["", "rgb"])
def test_tum_times_are_exact(tmp_path: Path, given: str) -> None:
    write(tmp_path / "rgb", ["1305031102.175304.png", "1305031102.211214.png"])
    lines = ["# color images", "# timestamp filename"]
    lines += [f"{name} rgb/{name}.png" for name in ("1305031102.175304", "1305031102.211214")]
    (tmp_path / "rgb.txt").write_text("\n".join(lines) + "\n")
    assert stamps(tmp_path / given) == [1305031102175304000, 1305031102211214000]


@pytest.mark.parametrize("place", ["image_0/times.txt", "times.txt"])
def test_kitti_times(tmp_path: Path, place: str) -> None:
    write(tmp_path / "image_0", ["000000.png", "000001.png", "000002.png"])
    (tmp_path / place).write_text("0.000000e+00\n1.036224e-01\n2.072430e-01\n")
    assert stamps(tmp_path / "image_0") == [0, 103622400, 207243000]
    (tmp_path / place).write_text("0\n1\n")
    with pytest.raises(InputError, match="2 times for 3 images"):
        FolderSource(tmp_path / "image_0")
    with pytest.raises(InputError, match="2 times for 3 images"):
        FolderSource(tmp_path)


def test_missing_and_damaged_images_keep_their_number(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write(tmp_path, ["a.png", "b.png", "e.png"])
    (tmp_path / "b.png").write_bytes((tmp_path / "b.png").read_bytes()[:60])
    (tmp_path / "c.png").mkdir()
    names = ["a", "b", "c", "d", "x" * 300, "nul\0", "e"]
    (tmp_path / "rgb.txt").write_text("".join(f"{number} {name}.png\n" for number, name in enumerate(names)))
    source = FolderSource(tmp_path)
    assert source.frame_count == 7
    assert [(frame.index, frame.stamp_ns) for frame in source] == [(0, 0), (6, 6 * 10**9)]
    assert source.skipped == 5
    assert len(caplog.records) == 1
    assert "skipped 5 frames" in caplog.text
    assert "b.png" in caplog.text


def test_only_unreadable_images_is_an_error(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"{number}.png").write_bytes(b"no image")
    source = FolderSource(tmp_path)
    with pytest.raises(InputError, match=r"not one image.*0\.png"):
        list(source)


def test_seek_skips_without_decoding(tmp_path: Path) -> None:
    write(tmp_path, [f"{number}.png" for number in range(10)])
    (tmp_path / "0.png").write_bytes(b"never read")
    source = FolderSource(tmp_path, fps=10)
    source.seek(0.55)
    assert source.frame_count == 4
    assert [frame.index for frame in source] == [6, 7, 8, 9]
    assert source.skipped == 0


@pytest.mark.parametrize("pattern", ["*.png", "*/*.png", "**/img*.png", "img[0-9].png", "img1?.png"])
def test_glob(tmp_path: Path, pattern: str) -> None:
    write(tmp_path, [f"img{number}.png" for number in range(12)] + [f"sub/img{number}.png" for number in range(12)])
    expected = {"*.png": 12, "*/*.png": 12, "**/img*.png": 24, "img[0-9].png": 10, "img1?.png": 2}[pattern]
    source = open_source(tmp_path / pattern)
    assert source.frame_count == expected
    assert len(list(source)) == expected


def test_name_can_name_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write(tmp_path / "walk.01", ["a.png", "b.png"])
    monkeypatch.chdir(folder)
    for spec, name in ((folder, "walk.01"), (".", "walk.01"), ("*.png", "walk.01"), (folder / "a.png", "a")):
        assert open_source(spec).name == name


MALFORMED = {
    "data.csv": ["#t,name\n12", "one,0.png\n", "nan,0.png\n", "1e999999999,0.png\n", "99999999999999999999,0.png\n"]
    + ["1,../secret.png\n", "1,/etc/secret.png\n", "1,a\\..\\..\\secret.png\n", "1,C:\\secret.png\n"]
    + ["2,0.png\n1,0.png\n", "1,0.png\n1,0.png\n", "#timestamp,filename\n", "\x00\x01"],
    "rgb.txt": ["1.0\n", "1.0 data/../../0.png\n", "Infinity data/0.png\n"],
    "times.txt": ["a\n", "0.5\n0.4\n", ""],
}


@pytest.mark.parametrize(("table", "content"), [(name, text) for name, texts in MALFORMED.items() for text in texts])
def test_malformed_times(tmp_path: Path, table: str, content: str) -> None:
    write(tmp_path / "data", ["0.png"])
    write(tmp_path, ["0.png", "1.png"])
    (tmp_path / table).write_text(content)
    if table != "data.csv":
        (tmp_path / "data").rename(tmp_path / "other")
    with pytest.raises(InputError) as caught:
        FolderSource(tmp_path)
    assert "\n" not in str(caught.value)


def test_nothing_there(tmp_path: Path) -> None:
    for spec in (tmp_path, tmp_path / "missing", tmp_path / "*.png", "x" * 5000, "nul\0", "[!"):
        with pytest.raises(InputError):
            FolderSource(spec)
    write(tmp_path, ["0.png"])
    for fps in (0, -1, 1e-300, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="frame rate"):
            FolderSource(tmp_path, fps=fps)


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ("flat", ["1.png", "a b.png"]),
        ("flat/*", ["1.png", "a b.png"]),
        ("flat/1.png", ["1.png"]),
        ("*/*.png", ["flat/1.png", "flat/a b.png", "other/1.png"]),
        ("tum", ["7.png"]),
        ("euroc", ["1403636579763555584.png"]),
    ],
)
def test_frames_have_their_files_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str, names: list[str]
) -> None:
    write(tmp_path / "flat", ["1.png", "a b.png"])
    write(tmp_path / "other", ["1.png"])
    write(tmp_path / "tum" / "rgb", ["7.png"])
    (tmp_path / "tum" / "rgb.txt").write_text("7 rgb/7.png\n")
    write(tmp_path / "euroc" / "mav0" / "cam0" / "data", ["1403636579763555584.png"])
    monkeypatch.chdir(tmp_path)
    for spec in (given, tmp_path / given):
        assert [frame.name for frame in FolderSource(spec)] == names

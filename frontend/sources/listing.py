"""Which images a folder, a pattern or a file names, and their times, from the first of these layouts that fits.

- EuRoC / ASL: `mav0/cam0/data.csv` ("stamp in ns,file name") and `mav0/cam0/data/`; the sequence, `mav0`, `cam0` or
  `data` may be given.
- TUM RGB-D: `rgb.txt` ("stamp in s  path"); the sequence or its `rgb` folder may be given.
- KITTI, raw: `timestamps.txt` (a date per image) beside `data/`; the drive, `image_00` or `data` may be given.
- KITTI, odometry: `times.txt` (one stamp in s per image) in the folder of images or in the one above it; or with rows
  "number  stamp in s  exposure", as DSO and TUM's monocular data sets have it.
- Images named by their time: since 1970 in a unit that its size tells, dates, or decimal seconds; see `names`.
- Any other table of text, in the folder or above, with rows "time  file name".
- Any other images: numbered by a frame rate.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path, PurePosixPath, PureWindowsPath
from statistics import median
from typing import NamedTuple

from natsort import natsorted

from airline.errors import ConfigError, InputError
from frontend.sources.image_names import (
    image_folders,
    images_in,
    is_image_name,
    matching,
    nothing_in,
    nothing_like,
    some,
    unread_in,
)
from frontend.sources.names import plausible, times_in
from frontend.sources.streams import choose_frames, says_depth
from frontend.sources.tables import (
    are_dates_or_since_1970,
    fields_of,
    inside,
    is_number,
    lines_of,
    split_heading,
    stamps_of,
    unit_said,
)

_LONG_STEP = 10 * 10**9  # ns
_MOST_TABLES = 100
_MOST_FOLDERS = 8  # of images, of which the first is taken
_SOME_LINES = 50  # tell a table of times from others, of which there may be many
_EACH_MOST = 1 << 24  # bytes of a table that is not known by its name
_TIMES = ("times.txt", "timestamps.txt", "timestamp.txt", "times.csv", "timestamps.csv")


class ImageRow(NamedTuple):
    """One image that a sequence lists. It may be missing on disk."""

    path: Path
    stamp_ns: int


@dataclass(frozen=True)
class Listing:
    """The images of an input in time order.

    Attributes:
        rows: one or more.
        kind: for people, what they were taken for.
        notes: for people, a sentence on each guess.
    """

    rows: list[ImageRow]
    kind: str = "images"
    notes: tuple[str, ...] = ()


def list_images(spec: str | os.PathLike[str], fps: float) -> Listing:
    """The images of a folder, a pattern (`*.png`, `%06d.png`) or a single file, in time order.

    Raises:
        InputError: nothing is there, a file of times is malformed or out of order, two images have the same time, or
            it cannot be told which pictures are the frames.
        ConfigError: the frame rate is impossible.
    """
    if not 1e-3 <= fps <= 1e6:
        raise ConfigError(f"the frame rate must be between 0.001 and 1,000,000 per second, not {fps}")
    root = Path(spec)
    try:
        if root.is_dir():
            images = images_in(root)
            notes = [f"left out for their format: {some(unread)}"] if images and (unread := unread_in(root)) else []
            found = _euroc(root) or _tum(root) or _kitti_raw(root) or _timed_by_line(root, images, notes)
            listing = found or _plain(images, fps, (root, root.parent), notes)
        elif root.exists():
            listing = replace(_named_by_time([root], []) or Listing([ImageRow(root, 0)]), kind="one image")
        else:
            images = matching(str(root))
            parents = list(dict.fromkeys(path.parent for path in images))
            listing = _plain(images, fps, (parents[0], parents[0].parent) if len(parents) == 1 else (), [])
    except (OSError, ValueError) as error:  # no permission; a name that no file can have
        raise InputError(f"cannot read '{root}': {error}") from error
    if listing is None and root.is_dir() and 0 < len(inside := image_folders(root)) <= _MOST_FOLDERS:
        listing = list_images(root / inside[0], fps)
        others = f", not {some(inside[1:])}" if inside[1:] else ""
        return replace(listing, notes=(f"the images of its folder '{inside[0]}' are taken{others}", *listing.notes))
    if listing is None:
        raise InputError(nothing_in(root) if root.is_dir() else nothing_like(root))
    for before, after in pairwise(listing.rows):
        if after.stamp_ns <= before.stamp_ns:
            what = "have the same time" if after.stamp_ns == before.stamp_ns else "are not in the order of their times"
            raise InputError(
                f"'{before.path.name}' and '{after.path.name}' of '{root}' {what}: name one of several cameras by a "
                "glob pattern, or correct the times"
            )
    notes, first_ns = list(listing.notes), listing.rows[0].stamp_ns
    steps = [after.stamp_ns - before.stamp_ns for before, after in pairwise(listing.rows)]
    if steps and (step := median(steps)) > _LONG_STEP:
        notes.append(f"images are {step / 1e9:g} s apart by their times: correct these if that is another unit")
    if first_ns < 0:
        notes.append(f"times begin below zero, at {first_ns / 1e9:g} s, and are counted from there")
    rows = [row._replace(stamp_ns=row.stamp_ns - min(first_ns, 0)) for row in listing.rows]
    return Listing(rows, listing.kind, tuple(notes))


def folder_of(rows: Sequence[ImageRow]) -> Path | None:
    """The folder of the images, beside which their calibration may lie; None where they are from several."""
    first, last = rows[0].path.parent, rows[-1].path.parent
    return first if first == last else None


def _euroc(root: Path) -> Listing | None:
    for camera in (root / "mav0" / "cam0", root / "cam0", root, *([root.parent] if root.name == "data" else [])):
        table, images = camera / "data.csv", camera / "data"
        if table.is_file():
            return _listed(table, images, "nanoseconds", "EuRoC sequence")
        if images.is_dir() and not (camera / "timestamps.txt").is_file():
            notes: list[str] = []
            times = _named_by_time(images_in(images), notes)
            return times and replace(times, kind="EuRoC sequence")
    return None


def _tum(root: Path) -> Listing | None:
    for sequence in (root, root.parent) if root.name == "rgb" else (root,):
        table = sequence / "rgb.txt"
        if table.is_file():
            return _listed(table, sequence, "seconds", "TUM RGB-D sequence")
    return None


def _kitti_raw(root: Path) -> Listing | None:
    camera = root.parent if root.name == "data" else root
    notes: list[str] = []
    if not (camera / "timestamps.txt").is_file():
        cameras = natsorted(path.parent.name for path in root.glob("image_*/timestamps.txt"))
        if not cameras:
            return None
        camera = root / cameras[0]
        if len(cameras) > 1:
            notes.append(f"of the cameras {', '.join(cameras)} the first is taken: give the folder of another")
    images = images_in(camera / "data") if (camera / "data").is_dir() else []
    return _by_line(camera / "timestamps.txt", images, "KITTI sequence", notes) if images else None


def _timed_by_line(root: Path, images: list[Path], notes: list[str]) -> Listing | None:
    """A table with a time for each image. One of the folder above may be of other images, which is noted."""
    for table in (folder / name for folder in (root, root.parent) for name in _TIMES):
        if images and table.is_file() and not any(map(is_image_name, fields_of(",".join(lines_of(table)[:2])))):
            is_kitti = table.name == _TIMES[0]
            try:
                return _by_line(
                    table, images, "KITTI sequence" if is_kitti else f"images with times in '{table.name}'", []
                )
            except InputError as error:
                if is_kitti or table.parent == root:
                    raise
                notes.append(f"times above are not taken: {error}")
    return None


def _by_line(table: Path, images: list[Path], kind: str, notes: list[str]) -> Listing:
    """A time for each image: by the id before it, which is the image's name or number, in order, or by its number.

    Raises:
        InputError: the number of times differs, and the images' names do not tell which are theirs.
    """
    images = choose_frames(images, notes)
    heading, rows = split_heading([fields_of(line) for line in lines_of(table)])
    if any(len(row) < 2 <= len(rows[0]) for row in rows):
        raise InputError(f"'{table}' has a line without a time")
    columns = list(zip(*rows, strict=False))
    numbers = [_whole(path.stem) for path in images]
    ids = [number for text in columns[0] if (number := _whole(text)) is not None] if len(columns) > 1 else []
    if len(ids) < len(rows) or not (set(numbers) <= set(ids) or all(b == a + 1 for a, b in pairwise(ids))):
        ids = []
    column = _column_of_times(columns, heading)
    if column is None:
        column = 1 if ids else 0
        if any(all(map(is_number, texts)) for texts in columns[column + 1 :]):
            notes.append(f"of the numbers of '{table.name}' those in column {column + 1} are taken for times")
    unit = unit_said(heading[column]) if heading else ""
    stamps = stamps_of(columns[column] if columns else (), table, unit or "seconds", notes)
    known: dict[int | None, int] = dict(zip(ids or range(len(stamps)), stamps, strict=True))
    if set(numbers) <= set(known) and (ids or len(stamps) != len(images)):
        if len(known) != len(images):
            which = "id" if ids else "number, from 0"
            notes.append(
                f"'{table.name}' has {len(known)} times for {len(images)} images: each takes that of its {which}"
            )
        return _in_order([ImageRow(path, known[n]) for path, n in zip(images, numbers, strict=True)], kind, notes)
    if len(stamps) != len(images):
        raise InputError(f"'{table}' has {len(stamps)} times for {len(images)} images: correct or move it")
    return Listing([ImageRow(image, stamp) for image, stamp in zip(images, stamps, strict=True)], kind, tuple(notes))


def _column_of_times(columns: Sequence[Sequence[str]], heading: Sequence[str], beside: int = 0) -> int | None:
    """The column nearest to another of dates or times since 1970, else of those whose heading tells of time."""
    dated = [column for column, texts in enumerate(columns) if are_dates_or_since_1970(texts)]
    said = [column for column, text in enumerate(heading[: len(columns)]) if unit_said(text)]
    numbers = [column for column in said if all(map(is_number, columns[column]))]
    return min(dated or numbers, key=lambda column: abs(column - beside), default=None)


def _whole(text: str) -> int | None:
    return int(text) if re.fullmatch(r"[0-9]{1,30}", text) else None


def _plain(images: list[Path], fps: float, folders: tuple[Path, ...], notes: list[str]) -> Listing | None:
    """Images without a layout: times in their names, or in a table, or by the frame rate."""
    images = choose_frames(images, notes)
    if not images:
        return None
    found = _named_by_time(images, notes) or _in_tables(images, folders, notes)
    if found is not None:
        return found
    if len(images) > 1:
        notes.append(f"images without times are numbered by {fps:g} frames/s: --fps gives another rate")
    return Listing([ImageRow(path, round(i * 1e9 / fps)) for i, path in enumerate(images)], "images", tuple(notes))


def _named_by_time(images: list[Path], notes: list[str]) -> Listing | None:
    times = times_in([path.stem for path in images])
    if times is None:
        return None
    odd = [path.name for place, path in enumerate(images) if place not in times.stamps]
    if odd:
        notes.append(f"left out of {len(images)} images for want of a time in the name: {some(odd)}")
    if times.words != "nanoseconds":
        notes.append(f"times are from the images' names, taken for {times.words} by their form and size")
    rows = [ImageRow(images[place], stamp) for place, stamp in times.stamps.items()]
    return _in_order(rows, "images named by their time", notes)


def _in_order(rows: list[ImageRow], kind: str, notes: list[str]) -> Listing:
    ordered = sorted(rows, key=lambda row: row.stamp_ns)
    if ordered != rows:
        notes.append("images are in the order of their times, not of their names")
    return Listing(ordered, kind, tuple(notes))


def _in_tables(images: list[Path], folders: tuple[Path, ...], notes: list[str]) -> Listing | None:
    """The table of any name, in the folder or the one above, that gives times to most of the images."""
    known = {str(number): path for path in images if (number := _whole(path.stem)) is not None}
    known |= {name: path for path in images for name in (path.stem, path.name)}
    best: list[ImageRow] = []
    chosen, said = "", list[str]()
    for folder in folders:
        for table in natsorted([*folder.glob("*.txt"), *folder.glob("*.csv")], key=str)[:_MOST_TABLES]:
            with suppress(InputError):  # no table of times
                if table.is_file() and table.stat().st_size <= _EACH_MOST:
                    words: list[str] = []
                    rows = _table_of_any_name(table, known, words)
                    if best and len(rows) == len(best) and rows != best:
                        said.append(f"'{table.name}' has other times than '{chosen}', which is taken")
                    if len(rows) > len(best):
                        best, chosen, said = rows, table.name, words
    if 2 * len(best) < len(images):
        return None
    missing = len(images) - len(best)
    if missing > 0:
        said.append(f"left out of {len(images)} images for want of a time in '{chosen}': {missing}")
    return _in_order(best, f"images with times in '{chosen}'", [*notes, *said, f"times are from '{chosen}'"])


def _table_of_any_name(table: Path, known: dict[str, Path], notes: list[str]) -> list[ImageRow]:
    """The images, by names that tables give them, with their times: dates, since 1970, or under a heading that says so.

    Rows may name several pictures, as of colour and depth, each beside its time. [] for another kind of table.
    """
    lines = lines_of(table)
    if not any(_named(name, known) for line in lines[:_SOME_LINES] for name in fields_of(line)):
        return []
    heading, rows = split_heading([fields_of(line) for line in lines])
    if len({len(row) for row in rows}) != 1:
        return []
    columns = list(zip(*rows, strict=True))
    for column, names in enumerate(columns):
        place = _column_of_times(columns, heading, column)
        if place is None or place == column or says_depth(Path(names[0])):
            continue
        if not is_image_name(names[0]) and len(set(names)) < len(names):
            continue  # numbers that come again are of something else
        kept = dict[Path, str]()
        for name, text in zip(names, columns[place], strict=True):
            if (path := _named(name, known)) is not None:
                kept.setdefault(path, text)
        if 2 * len(kept) >= len(rows) or is_image_name(names[0]):
            unit = (unit_said(heading[place]) if heading else "") or "seconds"
            stamps = dict(zip(kept, stamps_of(list(kept.values()), table, unit, notes), strict=True))
            if plausible(stamps.values()):
                return [ImageRow(path, stamps[path]) for path in dict.fromkeys(known.values()) if path in stamps]
    return []


def _named(name: str, known: dict[str, Path]) -> Path | None:
    """The image that a table means, perhaps with its folder, written on any system."""
    path = PurePosixPath(name.replace("\\", "/"))
    image = known.get(path.name) or (known.get(path.stem) if is_image_name(name) else None)
    here = PureWindowsPath(name).root or path.parent.name in ("", "..")  # a path from a root is of another machine
    return image if image is not None and (here or path.parent.name == image.parent.name) else None


def _listed(table: Path, folder: Path, unit: str, kind: str) -> Listing:
    """The rows "time, file name" of a table."""
    rows = []
    for line in lines_of(table):
        stamp, *names = re.split(r"\s*[,;\t]\s*|\s+", line, maxsplit=1)
        first = fields_of(names[0])[0] if names else ""
        if not first:
            raise InputError(f"'{table}' has a line that is not a time and a file name: {line[:60]!r}")
        rows.append([stamp.strip("\"'"), first if is_image_name(first) else names[0].strip("\"' ")])
    _, rows = split_heading(rows)
    if not rows:
        raise InputError(f"'{table}' lists no image")
    paths = [folder / inside(name, table) for _, name in rows]
    notes: list[str] = []
    stamps = stamps_of([stamp for stamp, _ in rows], table, unit, notes)
    return Listing([ImageRow(path, stamp) for path, stamp in zip(paths, stamps, strict=True)], kind, tuple(notes))

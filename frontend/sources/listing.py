"""Which images a folder, a glob pattern or a file names, and their times, from the first of these layouts that fits.

- EuRoC / ASL: `mav0/cam0/data.csv` ("stamp in ns,file name") and `mav0/cam0/data/`; the sequence, `mav0`, `cam0` or
  `data` may be given.
- TUM RGB-D: `rgb.txt` ("stamp in s  path"); the sequence or its `rgb` folder may be given.
- KITTI: `times.txt` (one stamp in s per image) in the folder of images or in the one above it; or with rows "number
  stamp in s  exposure", as DSO and TUM's monocular data sets have it.
- Images named by their stamp in nanoseconds.
- Any other images: numbered by a frame rate.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

from natsort import natsorted

from airline.errors import ConfigError, InputError

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})
_NS_DIGITS = 16  # a stamp in ns has 19 digits since 2001; 16 are four months of a clock that starts at zero
_MAX_STAMP = 2**63 - 1


class ImageRow(NamedTuple):
    """One image that a sequence lists. It may be missing on disk."""

    path: Path
    stamp_ns: int


def list_images(spec: str | os.PathLike[str], fps: float) -> list[ImageRow]:
    """The images of a folder, a glob pattern or a single file, in time order.

    Raises:
        InputError: nothing is there, or a file of times is malformed or out of order.
        ConfigError: the frame rate is impossible.
    """
    if not 1e-3 <= fps <= 1e6:
        raise ConfigError(f"the frame rate must be between 0.001 and 1,000,000 per second, not {fps}")
    root = Path(spec)
    try:
        if root.is_dir():
            rows = _euroc(root) or _tum(root) or _kitti(root) or _plain(_images_in(root), fps)
        else:
            files = [root] if root.exists() else [Path(name) for name in glob.glob(str(root), recursive=True)]  # noqa: PTH207
            rows = _plain([file for file in natsorted(files, key=str) if _is_image(file)], fps)
    except (OSError, ValueError) as error:  # no permission; a name that no file can have
        raise InputError(f"cannot read '{root}': {error}") from error
    if not rows:
        if not root.is_dir():
            magic = glob.has_magic(str(root))
            raise InputError(f"no image matches '{root}'" if magic else f"there is no folder or image '{root}'")
        inside = natsorted(child.name for child in root.iterdir() if child.is_dir() and _images_in(child))
        hint = f"; its folder '{inside[0]}' has some" if inside else ": give a folder of images or a video file"
        raise InputError(f"'{root}' holds no image{hint}")
    for before, after in pairwise(rows):
        if after.stamp_ns <= before.stamp_ns:
            raise InputError(
                f"the times of '{root}' are out of order: '{after.path.name}' is not later than '{before.path.name}'"
            )
    return rows


def folder_of(rows: list[ImageRow]) -> Path | None:
    """The folder of the images, beside which their calibration may lie; None where they are from several."""
    first, last = rows[0].path.parent, rows[-1].path.parent
    return first if first == last else None


def _euroc(root: Path) -> list[ImageRow]:
    for camera in (root / "mav0" / "cam0", root / "cam0", root, *([root.parent] if root.name == "data" else [])):
        table, images = camera / "data.csv", camera / "data"
        if table.is_file():
            return _listed(table, ",", images, 1)
        if images.is_dir():
            return _named_by_stamp(_images_in(images))
    return []


def _tum(root: Path) -> list[ImageRow]:
    for sequence in (root, root.parent) if root.name == "rgb" else (root,):
        table = sequence / "rgb.txt"
        if table.is_file():
            return _listed(table, None, sequence, 10**9)
    return []


def _kitti(root: Path) -> list[ImageRow]:
    images = _images_in(root)
    for table in (root / "times.txt", root.parent / "times.txt"):
        if images and table.is_file():
            rows = [(line, line.split()) for line in _lines(table)]
            stamps = [_nanoseconds(row[1] if len(row) == 3 else line, table, 10**9) for line, row in rows]
            if len(stamps) != len(images):
                raise InputError(f"'{table}' has {len(stamps)} times for {len(images)} images: correct or move it")
            return [ImageRow(image, stamp) for image, stamp in zip(images, stamps, strict=True)]
    return []


def _plain(images: list[Path], fps: float) -> list[ImageRow]:
    return _named_by_stamp(images) or [ImageRow(path, round(i * 1e9 / fps)) for i, path in enumerate(images)]


def _named_by_stamp(images: list[Path]) -> list[ImageRow]:
    stems = [path.stem for path in images]
    if not all(stem.isascii() and stem.isdigit() and len(stem) >= _NS_DIGITS for stem in stems):
        return []
    return [ImageRow(path, _nanoseconds(path.stem, path, 1)) for path in images]


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()


def _images_in(folder: Path) -> list[Path]:
    return natsorted([path for path in folder.iterdir() if _is_image(path)], key=lambda path: path.name)


def _lines(table: Path) -> Iterator[str]:
    """Lines that are neither empty nor a comment."""
    try:
        text = table.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"'{table}' is not a text file") from error
    return (line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#"))


def _listed(table: Path, separator: str | None, folder: Path, per_unit: int) -> list[ImageRow]:
    """The rows "time, file name" of a table."""
    rows = []
    for line in _lines(table):
        fields = line.split(separator, maxsplit=1)
        if len(fields) != 2:
            raise InputError(f"'{table}' has a line that is not a time and a file name: {line[:60]!r}")
        stamp, name = fields
        rows.append(ImageRow(folder / _inside(name.strip(), table), _nanoseconds(stamp, table, per_unit)))
    if not rows:
        raise InputError(f"'{table}' lists no image")
    return rows


def _nanoseconds(text: str, table: Path, per_unit: int) -> int:
    """Exact: 1305031102.175304 s has more digits than a float holds."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        value = Decimal("nan")
    limit = _MAX_STAMP // per_unit
    if not (value.is_finite() and -limit <= value <= limit):  # before multiplying, which may overflow
        raise InputError(f"'{table}' has a time that cannot be read: {text[:60]!r}")
    return int((value * per_unit).to_integral_value())


def _inside(name: str, table: Path) -> PurePosixPath:
    """A file name out of a table, which must not lead out of the sequence's folder."""
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or PureWindowsPath(name).drive or ".." in path.parts:
        raise InputError(f"'{table}' names a file outside its folder: {name[:60]!r}")
    return path

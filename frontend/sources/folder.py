"""Frames of a folder of images, whose times come from the first of these layouts that fits.

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
import logging
import os
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import replace
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

from natsort import natsorted

from airline.errors import ConfigError, InputError
from frontend.camera.calibration import fit_camera
from frontend.camera.layouts import find_calibration
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.reading import Image, Skips, decode_image

log = logging.getLogger(__name__)

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})
_NS_DIGITS = 16  # a stamp in ns has 19 digits since 2001; 16 are four months of a clock that starts at zero
_MAX_STAMP = 2**63 - 1


class FolderSource(Source):
    """Images of a folder in natural order (2.png before 10.png), or of a EuRoC, TUM RGB-D or KITTI sequence.

    Images that are missing or cannot be read are skipped and keep their number. Grey and 16-bit images stay so.

    Args:
        path: a folder, a glob pattern, or one image.
        fps: frames per second where no layout gives times.
        calibrated: take the calibration file that lies with the images, where data sets have theirs: frames carry its
            camera, and `calibration` names it from the first frame on. One that makes no sense costs a warning.

    Raises:
        InputError: there is no such folder, no image in it, or its times cannot be read; while iterating, when not
            one image can be read.
    """

    name: str
    calibration: str | None = None
    frame_count: int
    first_stamp_ns: int

    def __init__(self, path: str | os.PathLike[str], fps: float = 30.0, *, calibrated: bool = True) -> None:
        self._rows = list_images(path, fps)
        folder = Path(path) if os.path.isdir(path) else self._rows[0].path.parent  # noqa: PTH112
        self.name = Path(path).stem if os.path.isfile(path) else folder.resolve().name or "images"  # noqa: PTH113
        self._folder = os.path.commonpath([row.path.parent for row in self._rows])
        self.frame_count = len(self._rows)
        self.first_stamp_ns = self._rows[0].stamp_ns
        self._skips = Skips(self.name)
        first, last = self._rows[0].path.parent, self._rows[-1].path.parent
        self._found = find_calibration(first) if calibrated and first == last else None

    @property
    def skipped(self) -> int:
        return self._skips.count

    def seek(self, start_s: float) -> None:
        start_ns = self.first_stamp_ns + round(start_s * 1e9)
        self.frame_count = len(self._rows) - bisect_left(self._rows, start_ns, key=lambda row: row.stamp_ns)

    def __iter__(self) -> Iterator[Frame]:
        found = False
        try:
            for index in range(len(self._rows) - self.frame_count, len(self._rows)):
                row = self._rows[index]
                try:
                    image = decode_image(row.path.read_bytes()) if row.path.is_file() else None
                except (OSError, ValueError):  # no permission; a name that no file can have
                    image = None
                if image is None:
                    self._skips.add(str(row.path))
                    continue
                found = True
                name = row.path.relative_to(self._folder).as_posix()
                yield Frame(index, row.stamp_ns, image, self._camera(image), name=name)
        finally:
            self._skips.report(log)
        if self._skips.count and not found:
            raise InputError(f"not one image of '{self.name}' can be read; the first is '{self._skips.first}'")

    def _camera(self, image: Image) -> CameraModel | None:
        if self._found is None:
            return None
        height, width = image.shape[:2]
        try:
            camera = fit_camera(self._found.camera, width, height)
        except InputError as error:
            log.warning("going on without '%s': %s", self._found.file, error)
            self._found = None
            return None
        if camera is not self._found.camera:
            self._found = replace(self._found, camera=camera)
        self.calibration = self.calibration or str(self._found)
        return camera


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

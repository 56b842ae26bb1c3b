"""Lines that a person drew, read from files: a text file per image, or Wireframe's JSON."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import msgspec
import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from airline.evaluation.dataset import IMAGE_SUFFIXES

log = logging.getLogger(__name__)

MAX_BYTES = {".txt": 2**20, ".json": 2**28}  # of a file
MAX_LINES = 20_000  # of an image
BORDER = 1.0  # px by which a line may reach beyond the image


@dataclass(frozen=True)
class Drawn:
    """The lines of one image.

    Attributes:
        segments: (N, 2, 2) float32 px, finite.
        rows: N numbers of rows, from 1, as errors name them.
        source: where the rows stand, in words.
        size: (width, height) of the image that was drawn on, px; None where the file does not tell.
    """

    segments: NDArray[np.float32]
    rows: Sequence[int]
    source: str
    size: tuple[float, float] | None = None

    def check(self, width: int, height: int) -> None:
        """Raise InputError where the lines cannot be those of an image of this size, px."""
        if self.size is not None and self.size != (width, height):
            told = "x".join(f"{side:g}" for side in self.size)
            raise InputError(f"{self.source}: drawn on {told} px, but the image has {width}x{height} px: give the "
                             "image that was drawn on")  # fmt: skip
        low, high = -0.5 - BORDER, np.array([width, height]) - 0.5 + BORDER
        beyond = ((self.segments < low) | (self.segments > high)).any(axis=(1, 2))
        if beyond.any():
            row = self.rows[int(beyond.argmax())]
            raise InputError(f"{self.source}, row {row}: the line leaves the image of {width}x{height} px by more than "
                             f"{BORDER:g} px: end it at the border")  # fmt: skip


def read_drawn(folder: Path, images: Sequence[Path]) -> dict[Path, Drawn]:
    """Lines by image, in the order of `images`; an image without any file is not among them.

    `NAME.txt`, or `NAME.jpg.txt`, holds the lines of NAME.jpg, a row `x0 y0 x1 y1` each, px, with the centre of the
    top-left pixel at (0, 0); a row that begins with # is a remark. Every `.json` holds an image
    `{"filename", "lines": [[x0, y0, x1, y1], ...], "height", "width"}` or a list of them, as the Wireframe data set
    is handed around; all but `lines` may be missing from the file of one image, which then goes by its own name.
    Files that belong to no image are counted in a warning. Raises InputError for files that are malformed, too large
    or contradict each other, and where none belongs to an image.
    """
    named: dict[str, list[Path]] = {}
    for image in images:
        named.setdefault(image.stem, []).append(image)
    named |= {image.name: [image] for image in images}
    found: dict[Path, Drawn] = {}
    strays: list[str] = []
    for name, drawn in _read_all(folder, named):
        owners = _owners(name, named)
        if len(owners) > 1:
            raise InputError(f"{folder}: '{name}' may be {' or '.join(p.name for p in owners)}: give its full name")
        if not owners or drawn is None:
            strays.append(name)
        elif owners[0] in found:
            raise InputError(f"{owners[0].name} has lines in {found[owners[0]].source} and in {drawn.source}: keep one")
        else:
            found[owners[0]] = drawn
    if not folder.is_dir():
        raise InputError(f"there is no folder of labels {folder}")
    if not found:
        raise InputError(f"no labels of the images in {folder} ({len(strays)} of others): give NAME.txt for NAME.jpg, "
                         "or Wireframe's JSON")  # fmt: skip
    if strays:
        few = ", ".join(strays[:3]) + (", ..." if len(strays) > 3 else "")
        log.warning("labels of no image, left out: %d (%s)", len(strays), few)
    return {image: found[image] for image in images if image in found}


def _owners(name: str, named: dict[str, list[Path]]) -> list[Path]:
    """Images of this name; JSON may tell another ending than the image has now."""
    bare = PurePosixPath(name)
    return named.get(name) or (named.get(bare.stem, []) if bare.suffix.lower() in IMAGE_SUFFIXES else [])


def _read_all(folder: Path, named: dict[str, list[Path]]) -> Iterator[tuple[str, Drawn | None]]:
    """Names of images with their lines; text files of no image are not read."""
    for path in sorted(folder.glob("*")):
        kind = path.suffix.lower() if path.is_file() else ""
        if kind == ".txt":
            yield path.stem, _read_text(path) if _owners(path.stem, named) else None
        elif kind == ".json":
            yield from _read_json(path)


def _read_text(path: Path) -> Drawn:
    values, rows = [], []
    try:
        text = _content(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path} is no text: write a row x0 y0 x1 y1 per line") from None
    for row, line in enumerate(text.splitlines(), 1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            x0, y0, x1, y1 = map(float, fields)
        except ValueError:
            raise InputError(
                f"{path}, row {row}: '{line.strip()[:60]}' is not x0 y0 x1 y1: write four numbers"
            ) from None
        values.append((x0, y0, x1, y1))
        rows.append(row)
    return _drawn(values, rows, str(path))


class _Image(msgspec.Struct):
    lines: list[tuple[float, float, float, float]]
    filename: str | None = None
    height: float | None = None
    width: float | None = None


def _read_json(path: Path) -> Iterator[tuple[str, Drawn]]:
    try:
        content = msgspec.json.decode(_content(path), type=list[_Image] | _Image)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is no JSON of lines ({error}): give each image a `filename` and "
                         "`lines` [[x0, y0, x1, y1], ...]") from None  # fmt: skip
    for number, image in enumerate(content if isinstance(content, list) else [content]):
        if image.filename is None and isinstance(content, list):
            raise InputError(f"{path}: image {number} of the list has no `filename`: add it")
        name = PurePosixPath(image.filename).name if image.filename is not None else path.stem
        size = None if image.width is None or image.height is None else (image.width, image.height)
        yield name, _drawn(image.lines, range(1, len(image.lines) + 1), f"{path}, {name}", size)


def _drawn(
    values: list[tuple[float, float, float, float]],
    rows: Sequence[int],
    source: str,
    size: tuple[float, float] | None = None,
) -> Drawn:
    """Checked as far as that goes without the image."""
    if len(values) > MAX_LINES:
        raise InputError(f"{source}: {len(values)} lines are more than the {MAX_LINES} that an image may have")
    with np.errstate(over="ignore"):
        segments = np.array(values, np.float32).reshape(-1, 2, 2)
    finite = np.isfinite(segments).all(axis=(1, 2))
    if not finite.all():
        raise InputError(f"{source}, row {rows[int(finite.argmin())]}: it must be four finite numbers, px")
    return Drawn(segments, rows, source, size)


def _content(path: Path) -> bytes:
    limit = MAX_BYTES[path.suffix.lower()]
    with path.open("rb") as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        raise InputError(f"{path} has more than {limit >> 20} MB: give the lines of images and nothing else")
    return data

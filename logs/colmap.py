"""The lines of a LIMAP folder for the images of a COLMAP model: `python -m logs.colmap LIMAP MODEL --out FOLDER`.

A model may have some of the images only, under ids of its own. LIMAP takes ids from the model, and reads memory that is
not its own where matches name an image that the model has not. So images are found by name, all others are left out,
and neighbours are those that are left, however far apart.
"""

from __future__ import annotations

import argparse
import logging
import struct
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from airline.command import Parser, exit_code
from airline.errors import InputError
from frontend.camera.model import LARGEST
from logs.sinks.limap import CAMERAS, IDS, LARGEST_ID, SEGMENTS, LimapTrackSink, lines_of, listed, neighbours_of

log = logging.getLogger(__name__)

_PINHOLES = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4}  # how many numbers; in binary files they are models 0 and 1
_NUMBERS = (*_PINHOLES.values(), 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4, 6, 2)  # of each model in binary files
_LONGEST_NAME = 2**16
Camera = tuple[str, Sequence[float]]  # model and numbers
Pinhole = tuple[NDArray[np.float64], NDArray[np.float64]]  # (2,) focal lengths and principal point, px
Key = TypeVar("Key")
Value = TypeVar("Value")
Number = TypeVar("Number", int, float)


def fit_to_model(folder: Path, model: Path, out: Path, overwrite: bool = False) -> tuple[int, int]:
    """Write a LIMAP folder again for a model; returns how many images of the model have lines, and how many none.

    Args:
        folder: of `LimapTrackSink`.
        model: folder with COLMAP's cameras and images, .bin or .txt; its images without distortion.
        out: the new folder. Lines are moved to the pixels of the model's cameras where `folder` has its own.
        overwrite: write into a folder that holds files.

    Raises:
        InputError: one of them cannot be read or written, they have no image in common, or the model's camera has a
            lens, for which LIMAP would undistort images in a way of its own.
    """
    neighbours = neighbours_of(folder)
    images = read_model(model)
    if out.exists() and (out.samefile(folder) or out.samefile(model)):
        raise InputError(f"'{out}' is the folder that is read: choose another one")
    rows = {name: (number, stamp_ns) for number, stamp_ns, name in listed(folder) if name in images}
    own = _own_camera(folder / CAMERAS)
    if not rows:
        raise InputError(
            f"no image of '{folder}' is in the model '{model}', which has {', '.join(map(repr, [*images][:2]))}: "
            f"images.csv must have the same names"
        )
    if own is None:
        log.warning("%s has no camera: its lines must be of the model's undistorted images", folder.name)
    with closing(LimapTrackSink(out, neighbours=neighbours, overwrite=overwrite)) as sink:
        for name, (number, stamp_ns) in rows.items():
            image, (new_focal, new_centre) = images.pop(name)
            segments, ids = _lines_of(folder, number)
            if own is not None:
                focal, centre = own
                segments = (segments.reshape(-1, 2, 2) - centre) / focal * new_focal + new_centre
            sink.add(image, name, stamp_ns, segments.reshape(-1, 4), ids)
        for name, (image, _) in images.items():  # LIMAP asks for the lines of every image
            sink.add(image, name, "", np.zeros((0, 4)), np.zeros(0, np.int64))
    return len(rows), len(images)


def read_model(model: Path) -> dict[str, tuple[int, Pinhole]]:
    """Id and camera of each image, by its name, from COLMAP's files, the binary ones if there are both.

    Raises:
        InputError: they are not there or damaged, have no image, or the camera of one has a lens.
    """
    try:
        if (model / "images.bin").exists():
            images = _unique("image id", _binary_images(model / "images.bin"))
            cameras = _unique("camera", _binary_cameras(model / "cameras.bin"))
        else:
            images = _unique("image id", _text_images(model / "images.txt"))
            cameras = _unique("camera", _text_cameras(model / "cameras.txt"))
        if not images:
            raise ValueError("it has no images")
        for image, (name, camera) in images.items():
            if not 0 < image <= LARGEST_ID:
                raise ValueError(f"{name!r} has the id {image}, and ids go from 1 to {LARGEST_ID}")
            if camera not in cameras:
                raise ValueError(f"{name!r} has camera {camera}, which is not there")
        return _unique("name", ((name, (k, _pinhole(*cameras[camera]))) for k, (name, camera) in images.items()))
    except (OSError, ValueError, OverflowError, struct.error) as error:
        raise InputError(f"cannot read a COLMAP model from '{model}': {error}") from error


def _unique(what: str, pairs: Iterable[tuple[Key, Value]]) -> dict[Key, Value]:
    found: dict[Key, Value] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the {what} {key!r} is there twice")
        found[key] = value
    return found


def _pinhole(kind: str, numbers: Sequence[float]) -> Pinhole:
    if kind not in _PINHOLES:
        raise InputError(f"the model's camera ({kind}) has a lens: give the model that colmap image_undistorter writes")
    if len(numbers) != _PINHOLES[kind]:
        raise ValueError(f"a {kind} camera with {len(numbers)} numbers")
    if not all(abs(number) <= LARGEST for number in numbers) or min(numbers[:-2]) <= 0:
        raise ValueError(f"no camera has the numbers {' '.join(map(str, numbers))}")
    return np.array(numbers[:-2]), np.array(numbers[-2:])


def _number(kind: type[Number], text: str) -> Number:
    """Of the text of a number; Python would read "1_0", too."""
    if "_" in text or not text.isascii():
        raise ValueError(f"{text!r} is no number")
    return kind(text)


def _text_cameras(path: Path) -> Iterator[tuple[int, Camera]]:
    """Of lines "id model width height numbers"."""
    for line in lines_of(path):
        if line.strip() and line.lstrip()[0] != "#":
            camera, kind, _, _, *numbers = line.split()
            yield _number(int, camera), (kind, [_number(float, number) for number in numbers])


def _text_images(path: Path) -> Iterator[tuple[int, tuple[str, int]]]:
    lines = lines_of(path)
    for line in lines:
        if line.strip() and line.lstrip()[0] != "#":
            image, *pose, camera, name = line.split(maxsplit=9)
            if len(pose) != 7:
                raise ValueError(f"{line[:80].strip()!r} is no image")
            if len(next(lines, "").split()) % 3:
                raise ValueError(f"the line after {name.strip()!r} is not its points")
            yield _number(int, image), (name.strip(), _number(int, camera))


@contextmanager
def _binary(path: Path) -> Iterator[tuple[mmap, int]]:
    """What COLMAP wrote, in place of a copy in memory, and how many things the file says that it holds."""
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        yield data, struct.unpack_from("<Q", data)[0]


def _binary_cameras(path: Path) -> Iterator[tuple[int, Camera]]:
    at = 8
    with _binary(path) as (data, count):
        for _ in range(count):
            camera, model = struct.unpack_from("<Ii", data, at)
            if not 0 <= model < len(_NUMBERS):
                raise ValueError(f"camera {camera} has the unknown model {model}")
            kind = dict(enumerate(_PINHOLES)).get(model, f"model {model}")
            yield camera, (kind, struct.unpack_from(f"<{_NUMBERS[model]}d", data, at + 24))
            at += 24 + 8 * _NUMBERS[model]
        _check_end(path, data, at)


def _binary_images(path: Path) -> Iterator[tuple[int, tuple[str, int]]]:
    at = 8
    with _binary(path) as (data, count):
        for _ in range(count):
            image, *_, camera = struct.unpack_from("<I7dI", data, at)
            end = data.find(b"\0", at + 64, at + 64 + _LONGEST_NAME)
            if end < 0:
                raise ValueError(f"the name of image {image} has no end")
            yield image, (data[at + 64 : end].decode("utf-8", "surrogateescape"), camera)
            (points,) = struct.unpack_from("<Q", data, end + 1)
            at = end + 9 + 24 * points
        _check_end(path, data, at)


def _check_end(path: Path, data: mmap, at: int) -> None:
    if at != len(data):
        raise ValueError(f"{path.name} has {len(data)} bytes, and what it says that it holds {at}")


def _own_camera(path: Path) -> Pinhole | None:
    """Of a folder of ours, which may have none."""
    if not path.exists():
        return None
    try:
        ((_, camera),) = _text_cameras(path)
        return _pinhole(*camera)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read '{path}': {error}") from error


def _lines_of(folder: Path, number: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(K, 4) px and (K,) track ids."""
    path = folder / SEGMENTS / f"segments_{number}.txt"
    try:
        _, *numbers = "".join(lines_of(path)).split()
        ids = np.array("".join(lines_of(folder / IDS / f"track_ids_{number}.txt")).split(), np.int64)
        return np.array(numbers, np.float64).reshape(len(ids), 4), ids
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(f"cannot read '{path}' and its track ids: {error}") from error


def run(options: argparse.Namespace) -> None:
    """Write the folder, and print what is in it; raises AirLineError."""
    found, missing = fit_to_model(options.folder, options.model, options.out, options.overwrite)
    print(f"{options.out}: {found} images of the model have lines, {missing} have none")


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = Parser(prog="python -m logs.colmap", description=__doc__)
    parser.add_argument("folder", type=Path, metavar="LIMAP", help="folder of python -m frontend.run --out limap/")
    parser.add_argument("model", type=Path, metavar="MODEL", help="folder of a COLMAP model, such as sparse/")
    parser.add_argument("--out", type=Path, metavar="FOLDER", required=True, help="where to write it")
    parser.add_argument("--overwrite", action="store_true", help="write into a folder that holds files")
    return exit_code(run, parser.parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())

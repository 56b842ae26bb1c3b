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
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airline.command import Parser, exit_code
from airline.errors import InputError
from logs.sinks.limap import CAMERAS, IDS, SEGMENTS, LimapTrackSink, listed, neighbours_of

log = logging.getLogger(__name__)

_PINHOLES = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4}  # how many numbers; in binary files they are models 0 and 1
Pinhole = tuple[NDArray[np.float64], NDArray[np.float64]]  # (2,) focal lengths and principal point, px


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
    if out.exists() and out.samefile(folder):
        raise InputError(f"'{out}' is the folder that is read: choose another one")
    images = read_model(model)
    try:
        own = _camera_of((folder / CAMERAS).read_text("ascii"))[1] if (folder / CAMERAS).exists() else None
        rows = {name: (number, stamp_ns) for number, stamp_ns, name in listed(folder) if name in images}
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read '{folder}': {error}") from error
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
        InputError: they are not there or damaged, or a camera has a lens.
    """
    try:
        if (model / "images.bin").exists():
            images = _binary_images((model / "images.bin").read_bytes())
            cameras = _binary_cameras((model / "cameras.bin").read_bytes())
        else:
            images = _text_images((model / "images.txt").read_text("utf-8", "surrogateescape"))
            rows = (model / "cameras.txt").read_text("utf-8").splitlines()
            cameras = dict(map(_camera_of, (row for row in rows if row.strip() and row[0] != "#")))
        return {name: (image, cameras[camera]) for image, camera, name in images}
    except (OSError, ValueError, KeyError, OverflowError, struct.error) as error:
        raise InputError(f"cannot read a COLMAP model from '{model}': {error}") from error


def _pinhole(kind: str, numbers: list[float]) -> Pinhole:
    if kind not in _PINHOLES:
        raise InputError(f"the model's camera ({kind}) has a lens: give the model that colmap image_undistorter writes")
    if len(numbers) != _PINHOLES[kind]:
        raise ValueError(f"a {kind} camera with {len(numbers)} numbers")
    return np.array(numbers[:-2]), np.array(numbers[-2:])


def _camera_of(row: str) -> tuple[int, Pinhole]:
    """Of a line "id model width height numbers"."""
    camera, kind, _, _, *numbers = row.split()
    return int(camera), _pinhole(kind, list(map(float, numbers)))


def _text_images(text: str) -> Iterator[tuple[int, int, str]]:
    lines = iter(text.split("\n"))
    for line in lines:
        if line.strip() and not line.startswith("#"):
            image, *_, camera, name = line.split(maxsplit=9)
            yield int(image), int(camera), name.strip()
            next(lines, None)  # its points, of which there may be none


def _binary_cameras(data: bytes) -> dict[int, Pinhole]:
    at, cameras = 8, {}
    (count,) = struct.unpack_from("<Q", data)
    for _ in range(count):
        camera, number = struct.unpack_from("<Ii", data, at)
        kind = dict(enumerate(_PINHOLES)).get(number, f"model {number}")
        numbers = struct.unpack_from(f"<{_PINHOLES.get(kind, 0)}d", data, at + 24)
        cameras[camera] = _pinhole(kind, [*numbers])
        at += 24 + 8 * len(numbers)
    return cameras


def _binary_images(data: bytes) -> Iterator[tuple[int, int, str]]:
    at = 8
    (count,) = struct.unpack_from("<Q", data)
    for _ in range(count):
        image, *_, camera = struct.unpack_from("<I7dI", data, at)
        end = data.index(b"\0", at + 64)
        yield image, camera, data[at + 64 : end].decode("utf-8", "surrogateescape")
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points


def _lines_of(folder: Path, number: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(K, 4) px and (K,) track ids."""
    path = folder / SEGMENTS / f"segments_{number}.txt"
    try:
        _, *numbers = path.read_text("ascii").split()
        ids = np.array((folder / IDS / f"track_ids_{number}.txt").read_text("ascii").split(), np.int64)
        return np.array(numbers, np.float64).reshape(len(ids), 4), ids
    except (OSError, ValueError) as error:
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

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
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airline.command import Parser, exit_code
from airline.errors import InputError
from logs.sinks.limap import CAMERAS, IDS, SEGMENTS, LimapTrackSink, listed, neighbours_of

log = logging.getLogger(__name__)

_PINHOLES = ("SIMPLE_PINHOLE", "PINHOLE")  # by their number in COLMAP's binary files
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
    images, cameras = read_model(model)
    try:
        own = _camera_of((folder / CAMERAS).read_text("ascii")) if (folder / CAMERAS).exists() else None
        rows = [row for row in listed(folder) if row[2] in images]
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"cannot read '{folder}': {error}") from error
    if not rows:
        raise InputError(
            f"no image of '{folder}' is in the model '{model}', which has {', '.join(map(repr, [*images][:2]))}: "
            f"images.csv must have the same names"
        )
    if own is None:
        log.warning("%s has no camera: its lines must be of the model's undistorted images", folder.name)
    with closing(LimapTrackSink(out, neighbours=neighbours, overwrite=overwrite)) as sink:
        for number, stamp_ns, name in rows:
            image, camera = images.pop(name)
            segments, ids = _lines_of(folder, number)
            if own is not None:
                (focal, centre), (new_focal, new_centre) = own, cameras[camera]
                segments = (segments.reshape(-1, 2, 2) - centre) / focal * new_focal + new_centre
            sink.add(image, name, stamp_ns, segments.reshape(-1, 4), ids)
        for name, (image, _) in images.items():  # LIMAP asks for the lines of every image
            sink.add(image, name, "", np.zeros((0, 4)), np.zeros(0, np.int64))
    return len(rows), len(images)


def read_model(model: Path) -> tuple[dict[str, tuple[int, int]], dict[int, Pinhole]]:
    """Image and camera id by image name, and the cameras, of COLMAP's files, binary ones if there are both.

    Raises:
        InputError: they are not there or damaged, or a camera has a lens.
    """
    try:
        if (model / "images.bin").exists():
            return _binary_images((model / "images.bin").read_bytes()), _binary_cameras(model)
        lines = iter((model / "images.txt").read_text("utf-8", "surrogateescape").splitlines())
        images = {}
        for line in lines:
            if line.strip() and not line.startswith("#"):
                image, *_, camera, name = line.split(maxsplit=9)
                images[name.strip()] = int(image), int(camera)
                next(lines, None)  # its points, none of them perhaps
        rows = (model / "cameras.txt").read_text("utf-8").splitlines()
        return images, {int(row.split()[0]): _camera_of(row) for row in rows if row.strip() and row[0] != "#"}
    except (OSError, ValueError, IndexError, struct.error) as error:
        raise InputError(f"cannot read a COLMAP model from '{model}': {error}") from error


def _camera_of(row: str) -> Pinhole:
    """Of a line "id model width height numbers"."""
    _, kind, _, _, *numbers = row.split()
    return _pinhole(kind, list(map(float, numbers)))


def _pinhole(kind: str, numbers: list[float]) -> Pinhole:
    if kind not in _PINHOLES:
        raise InputError(f"the model's camera ({kind}) has a lens: give the model that colmap image_undistorter writes")
    return np.array(numbers[:-2]), np.array(numbers[-2:])


def _binary_cameras(model: Path) -> dict[int, Pinhole]:
    data, at, cameras = (model / "cameras.bin").read_bytes(), 8, {}
    (count,) = struct.unpack_from("<Q", data)
    for _ in range(count):
        camera, kind = struct.unpack_from("<Ii", data, at)
        numbers = struct.unpack_from("<4d" if kind == 1 else "<3d", data, at + 24)
        cameras[camera] = _pinhole(dict(enumerate(_PINHOLES)).get(kind, f"model {kind}"), [*numbers])
        at += 24 + 8 * len(numbers)
    return cameras


def _binary_images(data: bytes) -> dict[str, tuple[int, int]]:
    at, images = 8, {}
    (count,) = struct.unpack_from("<Q", data)
    for _ in range(count):
        image, *_, camera = struct.unpack_from("<I7dI", data, at)
        end = data.index(b"\0", at + 64)
        images[data[at + 64 : end].decode("utf-8", "surrogateescape")] = image, camera
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points
    return images


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

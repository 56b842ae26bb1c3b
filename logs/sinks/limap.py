"""Tracked lines in the folder layout that LIMAP loads instead of detecting and matching lines itself.

LIMAP (Liu et al., "3D Line Mapping Revisited", CVPR 2023; github.com/cvg/limap) asks for nothing but its
own files, named after the detector, extractor and matcher of its configuration; the names here are those of
`cfgs/triangulation/default_cpu.yaml`. Poses come from a COLMAP model, whose images `logs.colmap` finds by their names.
"""

from __future__ import annotations

import csv
import logging
import os
import pickle
import re
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError, InputError, errors_of
from frontend.camera.model import CameraModel
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from logs.sinks.output import LIMAP_FILES, OutputFile, check_folder, whole_file

log = logging.getLogger(__name__)

SEGMENTS, MATCHES, IDS = "line_detections/lsd/segments", "line_matchings/lsd/feats_lbd", "track_ids"
IMAGES, CAMERAS, NEIGHBOURS = LIMAP_FILES
LARGEST_ID = 2**31 - 1

_FILES = (
    *LIMAP_FILES,
    f"{SEGMENTS}/segments_*.txt",
    f"{IDS}/track_ids_*.txt",
    f"{MATCHES}/lbd_n*_top0/matches_*.npy",
)
_CORNER = 0.5
_LONGEST_LINE = 2**26
_ROW = re.compile(r"[1-9]\d*,-?\d*,.*", re.ASCII | re.DOTALL)


class LimapTrackSink:
    """Writes each frame's lines, and which of them are the same line in the frames around it; a `Sink`.

    | file | what it holds |
    |---|---|
    | line_detections/lsd/segments/segments_ID.txt | number of lines, then x0 y0 x1 y1 of each |
    | line_matchings/lsd/feats_lbd/lbd_nN_top0/matches_ID.npy | for each neighbour its (K, 2) pairs of rows |
    | metainfos.txt | neighbours of each image, for `--load_meta`; written by `close` or `python -m logs.repair` |
    | cameras.txt | the camera of the lines, COLMAP's text format; where known |
    | track_ids/track_ids_ID.txt | track id of each segment; for others than LIMAP |
    | images.csv | image id, stamp and name of every image whose files are complete |

    Images are numbered as COLMAP numbers those of a folder, from 1: the id is the frame's number and 1. That is the id
    in a COLMAP model of the same images if their names sort as the frames do and all can be read; in any other case
    `logs.colmap` writes the folder for a model. The name is that of the image's file, relative to the folder that holds
    them all; frames of videos and logs have none, and get their number, as in 000012.png.

    Lines are the fused ones of all tracks. LIMAP wants images without distortion and follows COLMAP, whose (0, 0) is
    the corner of the top-left pixel. So lines are undistorted where the camera is known, for a pinhole camera of the
    same focal lengths and principal point, that of `cameras.txt`, and moved by half a pixel: leave LIMAP's
    `triangulation.add_halfpix` off. Lines with an end that no undistortion reaches are left out, and points.

    Args:
        folder: made if it does not exist.
        neighbours: of each image, an even number, half before and half after it; LIMAP's `n_neighbors`.
        overwrite: write into a folder that holds files; those of an earlier run are removed, others kept.

    Raises:
        InputError: the folder holds files, with `overwrite` images.csv, cameras.txt or metainfos.txt without the lines
            of an earlier run; it cannot be written; a camera that changes, comes or goes.
    """

    def __init__(self, folder: str | os.PathLike[str], *, neighbours: int = 20, overwrite: bool = False) -> None:
        if neighbours < 2 or neighbours % 2:
            raise ConfigError(f"{neighbours} neighbours: give an even number, as many before as after each image")
        self._folder = Path(folder)
        check_folder(self._folder, overwrite)
        self._segments = self._folder / SEGMENTS
        self._ids = self._folder / IDS
        self._matches = self._folder / MATCHES / f"lbd_n{neighbours}_top0"
        with errors_of(self._folder):
            for old in _FILES:
                for path in self._folder.glob(old):  # LIMAP would take them for images of this run
                    path.unlink()
            for made in (self._segments, self._matches, self._ids):
                made.mkdir(parents=True, exist_ok=True)
        self._neighbours = neighbours
        self._images = OutputFile(self._folder / IMAGES, overwrite=True)
        with self._images.writing() as file:
            file.write(b"image_id,stamp_ns,name\n")
        self._window: deque[tuple[int, NDArray[np.int64], dict[int, NDArray[np.int32]]]] = deque()
        self._camera: str | None = None
        self._points = self._partners = 0  # that were left out
        self._last, self._last_name, self._in_order = -1, "", True

    def write(self, result: FrameResult) -> None:
        """Add one frame."""
        tracks = result.tracks
        if not self._last < tracks.frame_index < LARGEST_ID:
            raise InputError(f"cannot write '{self._folder}': frame {tracks.frame_index} follows frame {self._last}")
        name = result.frame.name or f"{tracks.frame_index:06d}.png"
        if self._in_order and name < self._last_name:
            log.warning("COLMAP sorts '%s' before '%s': take its ids with python -m logs.colmap", name, self._last_name)
            self._in_order = False
        self._last, self._last_name = tracks.frame_index, name
        with self._images.writing(), errors_of(self._folder):
            self._write_camera(tracks.camera)
        self._points += len(tracks.point_ids)
        self._partners += int(np.count_nonzero(tracks.right_hits))
        self.add(tracks.frame_index + 1, name, tracks.stamp_ns, *_lines(tracks))

    def add(
        self, image: int, name: str, stamp_ns: int | str, segments: NDArray[np.float64], ids: NDArray[np.int64]
    ) -> None:
        """Add an image's lines as they go into its file: (K, 4) px, as COLMAP counts them, and (K,) track ids."""
        with self._images.writing() as file, errors_of(self._folder):
            self._match(image, ids)
            text = f"{len(segments)}\n" + "%.4f %.4f %.4f %.4f\n" * len(segments) % tuple(segments.ravel().tolist())
            part = self._segments.with_suffix(".tmp")  # LIMAP takes every file in the folder for segments
            with whole_file(self._segments / f"segments_{image}.txt", part) as lines:
                lines.write(text.encode("ascii"))
            (self._ids / f"track_ids_{image}.txt").write_text("".join(f"{one}\n" for one in ids.tolist()), "ascii")
            quoted = name.replace('"', '""')
            file.write(f'{image},{stamp_ns},"{quoted}"\n'.encode("utf-8", "surrogateescape"))
            file.flush()

    def close(self) -> None:
        """Write the last matches and the table of neighbours; safe to call twice."""
        if self._images.is_open:
            self._images.close()
            with errors_of(self._folder):
                for image, _, matches in self._window:
                    self._write_matches(image, matches)
            finish_folder(self._folder, self._neighbours)
            if self._points:
                log.warning("'%s': LIMAP takes no points, %d are left out", self._folder, self._points)
            if self._partners:
                log.warning("'%s': LIMAP takes the left lines, %d partners are left out", self._folder, self._partners)

    def _match(self, image: int, ids: NDArray[np.int64]) -> None:
        """Match with the images before; an image is done with when its last neighbour has been seen."""
        own: dict[int, NDArray[np.int32]] = {}
        for earlier, earlier_ids, matches in self._window:
            _, rows, earlier_rows = np.intersect1d(ids, earlier_ids, assume_unique=True, return_indices=True)
            own[earlier] = np.stack([rows, earlier_rows], axis=1).astype(np.int32)
            matches[image] = np.ascontiguousarray(own[earlier][:, ::-1])
        self._write_matches(image, own)
        self._window.append((image, ids, own))
        if len(self._window) > self._neighbours // 2:
            done, _, matches = self._window.popleft()
            self._write_matches(done, matches)

    def _write_matches(self, image: int, matches: dict[int, NDArray[np.int32]]) -> None:
        """What `np.save` makes of a dictionary, in a form that NumPy 1, which LIMAP runs with, loads too."""
        text = pickle.dumps(np.array(matches, object), protocol=3)
        with whole_file(self._matches / f"matches_{image}.npy") as file:
            np.lib.format.write_array_header_1_0(file, {"descr": "|O", "fortran_order": False, "shape": ()})
            file.write(text.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n"))

    def _write_camera(self, camera: CameraModel | None) -> None:
        text = ""
        if camera is not None:
            numbers = map(float, (camera.fx, camera.fy, camera.cx + _CORNER, camera.cy + _CORNER))
            text = f"1 PINHOLE {camera.width} {camera.height} {' '.join(map(repr, numbers))}\n"
        if self._camera not in (None, text):
            how = "changes" if text and self._camera else "is known for some frames only"
            raise InputError(f"cannot write '{self._folder}': the camera {how}, and LIMAP's files know one for all")
        if text and self._camera is None:
            (self._folder / CAMERAS).write_text(text, encoding="ascii")
        self._camera = text


def _lines(tracks: LineTracks) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(K, 4) px without distortion, with (0, 0) at the corner of the top-left pixel, and the (K,) ids."""
    camera, segments = tracks.camera, tracks.segments_px.astype(np.float64)
    if camera is not None and camera.distortion != "none":
        segments = camera.normalize(segments) * np.array([camera.fx, camera.fy]) + (camera.cx, camera.cy)
    found = np.isfinite(segments).all((1, 2))
    return (segments[found] + _CORNER).reshape(-1, 4), tracks.ids[found]


def finish_folder(folder: Path, neighbours: int) -> int:
    """Write the table of neighbours of the images in `images.csv`, without limits on the scene; returns how many."""
    with errors_of(folder / NEIGHBOURS):
        images = [image for image, *_ in listed(folder)]
        lines = [f"number of images, {len(images)}", *(f"{axis}-range, -inf, inf" for axis in "xyz")]
        for k, image in enumerate(images):
            around = images[max(k - neighbours // 2, 0) : k] + images[k + 1 : k + 1 + neighbours // 2]
            lines.append(", ".join([f"image {image}", *around]))
        (folder / NEIGHBOURS).write_text("\n".join(lines) + "\n", encoding="ascii")
    return len(images)


def repair_folder(folder: Path) -> int:
    """Finish the folder of a run that never ended; returns how many images it has, raises InputError."""
    return finish_folder(folder, neighbours_of(folder))


def neighbours_of(folder: Path) -> int:
    """How many neighbours an image has in a folder of ours; raises InputError for any other."""
    names = sorted(path.name for path in (folder / MATCHES).glob("lbd_n*_top0"))
    count = names[0].removeprefix("lbd_n").removesuffix("_top0") if names else ""
    if not count.isdecimal() or not (folder / IMAGES).is_file():
        raise InputError(f"'{folder}' is no folder of tracks for LIMAP")
    return int(count)


def listed(folder: Path) -> list[list[str]]:
    """Image id, stamp and name of the images that are complete; raises InputError."""
    path = folder / IMAGES
    try:
        rows = list(csv.reader(lines_of(path), strict=True))[1:]
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"cannot read '{path}': {error}") from error
    for number, row in enumerate(rows, 2):
        if len(row) != 3 or not _ROW.fullmatch(",".join(row)):
            raise InputError(f"cannot read '{path}': row {number} is no image's id, stamp and name; mend or remove it")
    return rows


def lines_of(path: Path) -> Iterator[str]:
    """The lines of a text file; raises OSError, and ValueError before one fills the memory."""
    with path.open(encoding="utf-8", errors="surrogateescape", newline="\n") as file:
        while line := file.readline(_LONGEST_LINE):
            if len(line) == _LONGEST_LINE:
                raise ValueError(f"{path.name} has a line of {_LONGEST_LINE} characters and more")
            yield line

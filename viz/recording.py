"""A recording read back frame by frame: its image and the lines over it, as the viewer would show them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from airline.errors import InputError
from viz.recorded_images import Picture, RecordedImages

IMAGE = "/camera/image"
ROOTS = (("/camera",), ("/a", "/b"))  # of a run, and of a comparison of two
LAYERS = ("tails", "tracks/lost", "unmatched", "tracks")  # below each root, the lowest first
CORNER = 0.5  # Rerun puts (0, 0) at the corner of the top-left pixel, we put it at its centre
BACKGROUND = 30  # grey level where a recording has no images
WIDE_POINTS = 4 / 3  # pixels of line width per point of radius: 2 for confirmed tracks, 1 for all others


@dataclass(frozen=True)
class Strips:
    """Polylines of one look.

    Attributes:
        points: of each polyline, (P, 2) float32 px.
        colours: (N, 4) uint8 RGBA.
        widths: (N,) px.
    """

    points: list[NDArray[np.float32]]
    colours: NDArray[np.uint8]
    widths: NDArray[np.int_]


@dataclass(frozen=True)
class RecordedFrame:
    """What was logged for one frame.

    Attributes:
        index: on the timeline `frame`.
        time_ns: sensor time, None where the recording has none.
        image: (H, W, 3) uint8 BGR; plain dark where the recording has none.
        panels: the lines over it, one list of layers for each run in the recording.
    """

    index: int
    time_ns: int | None
    image: Picture
    panels: list[list[Strips]]


class Recording:
    """A .rrd file of this project. Frames are those in which tracks were logged.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read, or has no tracks.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise InputError(f"there is no recording {path}: give an .rrd file")
        self._path = path
        paths: set[str] = set()
        frames: dict[str, dict[int, int | None]] = {}
        self._static: list[Any] = []  # what stands for the image in all frames
        self._size: tuple[int, int] | None = None
        for chunk in self._chunks():
            paths.add(chunk.entity_path)
            rows = chunk.to_record_batch()
            if chunk.entity_path.endswith("/tracks") and "frame" in rows.schema.names:
                frames.setdefault(chunk.entity_path, {}).update(_times(rows))
            if chunk.is_static and chunk.entity_path == IMAGE:
                self._static.append(rows)
            if "Pinhole:resolution" in rows.schema.names and self._size is None:
                width, height = rows.column("Pinhole:resolution")[0].values[0].as_py()
                self._size = int(width), int(height)
        self._roots = next((roots for roots in ROOTS if f"{roots[0]}/tracks" in frames), ())
        if not self._roots:
            raise InputError(f"the recording {path} has no tracks on a timeline 'frame': give one of this project")
        self._paths = paths
        self._times = dict(sorted(frames[f"{self._roots[0]}/tracks"].items()))

    @property
    def indices(self) -> list[int]:
        """All frames, ascending."""
        return list(self._times)

    @property
    def fps(self) -> float:
        """Frames per second, by the median distance in time of consecutive frames; 30 where the times do not tell."""
        times = np.array([time for time in self._times.values() if time is not None], np.int64)
        step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        return 1e9 / step if step > 0 else 30.0

    def at(self, index: int) -> int:
        """The frame that is shown at an index: the latest one up to there. Raises InputError outside of all frames."""
        first, last = min(self._times), max(self._times)
        if not first <= index <= last:
            raise InputError(f"there is no frame {index}: choose one from {first} to {last}")
        return max(frame for frame in self._times if frame <= index)

    def frames(self, start: int | None = None, end: int | None = None) -> Iterator[RecordedFrame]:
        """Frames from `start` to `end`, both included, in bounded memory."""
        image = RecordedImages()
        for rows in self._static:
            image.take(rows, 0)
        images = _Cursor(self._rows(IMAGE))
        layers = [[_Cursor(self._rows(f"{root}/{name}")) for name in LAYERS] for root in self._roots]
        for frame, time_ns in self._times.items():
            if (start is not None and frame < start) or (end is not None and frame > end):
                continue
            row = images.at(frame)
            if row is not None:
                image.take(*row)
            panels = [
                [_strips(*row) for row in (c.at(frame) for c in cursors) if row is not None] for cursors in layers
            ]
            picture = image.picture()
            yield RecordedFrame(frame, time_ns, self._dark(panels) if picture is None else picture, panels)

    def _rows(self, entity: str) -> Iterator[tuple[int, Any, int]]:
        """Frame, table and row of everything that was logged to an entity, in the order of the frames."""
        if entity not in self._paths:
            return
        last = -1
        for chunk in self._chunks(entity):
            rows = chunk.to_record_batch()
            frames = rows.column("frame").to_numpy()
            for k in np.argsort(frames, kind="stable").tolist():
                if frames[k] < last:
                    raise InputError(f"the recording {self._path} is not in the order of its frames: record it again")
                last = int(frames[k])
                yield last, rows, k

    def _chunks(self, entity: str | None = None) -> Iterator[Any]:
        try:
            stream = RrdReader(self._path).stream()
            yield from stream if entity is None else stream.filter(content=entity, has_timeline="frame")
        except (OSError, RuntimeError, ValueError) as error:
            raise InputError(f"cannot read the recording {self._path}, it is damaged or none: {error}") from error

    def _dark(self, panels: list[list[Strips]]) -> Picture:
        """What lines are drawn on without an image, as large as the camera's or as the lines need."""
        if self._size is None:
            points = [strip for layers in panels for strips in layers for strip in strips.points]
            far = np.max([strip.max(axis=0) for strip in points], axis=0) if points else np.array([639, 479])
            self._size = int(np.clip(far[0] + 1, 16, 16384)), int(np.clip(far[1] + 1, 16, 16384))
        return np.full((self._size[1], self._size[0], 3), BACKGROUND, np.uint8)


class _Cursor:
    """The latest row at or before a frame; frames are asked for in ascending order."""

    def __init__(self, rows: Iterator[tuple[int, Any, int]]) -> None:
        self._rows = rows
        self._latest: tuple[Any, int] | None = None
        self._next = next(rows, None)

    def at(self, frame: int) -> tuple[Any, int] | None:
        while self._next is not None and self._next[0] <= frame:
            self._latest = self._next[1:]
            self._next = next(self._rows, None)
        return self._latest


def _strips(rows: Any, k: int) -> Strips:
    lists = rows.column("LineStrips2D:strips")[k].values
    if lists is None or not len(lists):
        return Strips([], np.zeros((0, 4), np.uint8), np.zeros(0, int))
    points = lists.flatten().flatten().to_numpy(zero_copy_only=False).reshape(-1, 2) - np.float32(CORNER)
    colours = _column(rows, k, "LineStrips2D:colors", 0xFFFFFFFF, len(lists)).astype(np.uint32)
    radii = _column(rows, k, "LineStrips2D:radii", -0.75, len(lists))
    return Strips(
        np.split(points, np.cumsum(lists.value_lengths().to_numpy())[:-1]),
        np.stack([colours >> shift & 255 for shift in (24, 16, 8, 0)], axis=1).astype(np.uint8),
        np.maximum(np.rint(np.abs(radii) * WIDE_POINTS), 1).astype(int),  # radii below 0 are points of the screen
    )


def _column(rows: Any, k: int, name: str, default: float, count: int) -> NDArray[Any]:
    """One value for each strip: Rerun lets the last one stand for all that follow."""
    found = rows.column(name)[k].as_py() if name in rows.schema.names else None
    values = np.array(found or [default])
    return values[np.minimum(np.arange(count), len(values) - 1)]


def _times(rows: Any) -> dict[int, int | None]:
    """Sensor time of each frame, ns."""
    frames = rows.column("frame").to_pylist()
    name = next((name for name in ("sensor_time", "video_time") if name in rows.schema.names), None)
    return dict(
        zip(frames, [None] * len(frames) if name is None else rows.column(name).cast("int64").to_pylist(), strict=True)
    )

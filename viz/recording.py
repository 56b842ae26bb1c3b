"""A recording read back frame by frame: its image and the lines over it, as the viewer would show them."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from airline.errors import InputError
from airline.image import to_uint8
from viz.rerun_private import CORNER

IMAGE = "/camera/image"
# Of a run, with a right image or without, and of a comparison of two: what has tracks, and the image below them
ROOTS = ({"/camera": IMAGE, "/right": "/right/image"}, {"/a": IMAGE, "/b": IMAGE})
LAYERS = ("tails", "unmatched", "tracks")  # below each root, the lowest first; what the default layout shows
BACKGROUND = 30  # grey level where a recording has no images
WIDE_POINTS = 4 / 3  # pixels of line width per point of the screen, which radii below 0 are in
CODECS = {b"avc1": "h264", b"hev1": "hevc", b"vp09": "vp9", b"av01": "libdav1d"}  # FFmpeg's, by Rerun's names
CHANNELS = {1: 1, 4: 3}  # of the colour models that the sink writes, by Rerun's numbers: L and BGR

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Strips:
    """Polylines of one layer.

    Attributes:
        points: N of (P, 2) float32 px.
        colours: (N, 3) uint8 RGB.
        widths: (N,) px.
    """

    points: list[NDArray[np.float32]]
    colours: NDArray[np.uint8]
    widths: NDArray[np.int_]


@dataclass(frozen=True)
class RecordedFrame:
    """What was logged for one frame.

    Attributes:
        images: (H, W, 3) uint8 BGR, plain dark where the recording has none: the left and the right one, or one for
            each run in the recording.
        panels: the lines over them, a list of layers for each.
    """

    images: list[Picture]
    panels: list[list[Strips]]


class Recording:
    """A .rrd file of this project. Frames are those in which tracks were logged.

    Args:
        path: the file.

    Attributes:
        indices: of all frames, ascending.
        fps: frames per second, by the median distance in time of consecutive frames; 30 where the times do not tell.

    Raises:
        InputError: it cannot be read, or has no tracks.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise InputError(f"there is no recording {path}: give an .rrd file")
        self._path = path
        self._paths: set[str] = set()
        self._images = {entity: _Images() for roots in ROOTS for entity in roots.values()}
        self._size: tuple[int, int] | None = None
        times: dict[str, dict[int, int]] = {}
        for chunk in self._chunks():
            self._paths.add(chunk.entity_path)
            rows = chunk.to_record_batch()
            names = rows.schema.names
            if chunk.entity_path.endswith("/tracks") and "frame" in names:
                stamps = rows.column("sensor_time" if "sensor_time" in names else "frame").cast("int64").to_pylist()
                frames = rows.column("frame").to_pylist()
                times.setdefault(chunk.entity_path, {}).update(zip(frames, stamps, strict=True))
            if chunk.is_static and chunk.entity_path == IMAGE:
                self._images[IMAGE].take(rows, 0)
            if "Pinhole:resolution" in names and self._size is None:
                width, height = rows.column("Pinhole:resolution")[0].values[0].as_py()
                self._size = int(width), int(height)
        self._roots = {root: image for roots in ROOTS for root, image in roots.items() if f"{root}/tracks" in times}
        if not self._roots:
            raise InputError(f"the recording {path} has no tracks on a timeline 'frame': give one of this project")
        found = times[f"{next(iter(self._roots))}/tracks"]
        self.indices = sorted(found)
        step = float(np.median(np.diff([found[k] for k in self.indices]))) if len(found) > 1 else 0.0
        self.fps = 1e9 / step if step > 1 else 30.0  # without times, frames are one apart

    def at(self, index: int) -> int:
        """The frame that is shown at an index: the latest one up to there. Raises InputError outside of all frames."""
        first, last = self.indices[0], self.indices[-1]
        if not first <= index <= last:
            raise InputError(f"there is no frame {index}: choose one from {first} to {last}")
        return max(frame for frame in self.indices if frame <= index)

    def frames(self, start: int | None = None, end: int | None = None) -> Iterator[RecordedFrame]:
        """Frames from `start` to `end`, both included, in bounded memory; to be asked for once."""
        images = {entity: _Cursor(self._rows(entity)) for entity in self._roots.values()}
        layers = [[_Cursor(self._rows(f"{root}/{name}")) for name in LAYERS] for root in self._roots]
        for frame in self.indices:
            if (start is not None and frame < start) or (end is not None and frame > end):
                continue
            for entity, cursor in images.items():
                for row in cursor.up_to(frame):
                    self._images[entity].take(*row)
            panels = [
                [_strips(*row) for row in (c.at(frame) for c in cursors) if row is not None] for cursors in layers
            ]
            pictures = {entity: self._images[entity].picture() for entity in images}
            yield RecordedFrame([self._below(pictures[image], panels) for image in self._roots.values()], panels)

    def _rows(self, entity: str) -> Iterator[tuple[int, Any, int]]:
        """Frame, table and row of everything that was logged to an entity, in the order of the frames."""
        last = -1
        for chunk in self._chunks(entity) if entity in self._paths else ():
            rows = chunk.to_record_batch()
            if not any(":" in name for name in rows.schema.names):
                continue  # ids and the like, which `rerun rrd optimize` may put into chunks of their own
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

    def _below(self, picture: Picture | None, panels: list[list[Strips]]) -> Picture:
        """What lines are drawn on: without a picture, dark, as large as the last one, the camera's or as they need."""
        if picture is not None:
            self._size = picture.shape[1], picture.shape[0]
            return picture
        if self._size is None:
            corners = [strip.max(axis=0) for layers in panels for strips in layers for strip in strips.points]
            width, height = np.clip(np.max(corners or [[639, 479]], axis=0) + 1, 16, 16384)
            self._size = int(width), int(height)
        return np.full((self._size[1], self._size[0], 3), BACKGROUND, np.uint8)


class _Cursor:
    """The latest row at or before a frame; frames are asked for in ascending order."""

    def __init__(self, rows: Iterator[tuple[int, Any, int]]) -> None:
        self._rows = rows
        self._latest: tuple[Any, int] | None = None
        self._next = next(rows, None)

    def at(self, frame: int) -> tuple[Any, int] | None:
        for row in self.up_to(frame):
            self._latest = row
        return self._latest

    def up_to(self, frame: int) -> Iterator[tuple[Any, int]]:
        """All rows that are new since the last call."""
        while self._next is not None and self._next[0] <= frame:
            yield self._next[1:]
            self._next = next(self._rows, None)


class _Images:
    """The image of the row that was taken last, in whatever form: JPEG, raw pixels, a video's frame or its packet."""

    def __init__(self) -> None:
        self._row: tuple[Any, int] | None = None
        self._video: Iterator[Any] = iter(())
        self._shown: Any = None
        self._next: Any = None
        self._decoder: Any = None

    def take(self, rows: Any, k: int) -> None:
        if "AssetVideo:blob" in rows.schema.names:
            import av  # FFmpeg takes time to import

            self._video = av.open(io.BytesIO(_bytes(rows, k, "AssetVideo:blob")), "r").decode(video=0)
            self._shown = self._next = next(self._video, None)
        elif "VideoStream:codec" in rows.schema.names:
            from av import CodecContext

            fourcc = rows.column("VideoStream:codec")[k].values[0].as_py()
            self._decoder = CodecContext.create(CODECS[fourcc.to_bytes(4, "big")], "r")
        elif "VideoStream:sample" in rows.schema.names:
            from av import Packet

            for frame in self._decoder.decode(Packet(_bytes(rows, k, "VideoStream:sample"))):
                self._shown = frame
            self._row = rows, k
        else:
            self._row = rows, k

    def picture(self) -> Picture | None:
        """(H, W, 3) uint8 BGR, None without any."""
        if self._row is None:
            return None
        rows, k = self._row
        image: Any = None
        if "EncodedImage:blob" in rows.schema.names:
            image = cv2.imdecode(np.frombuffer(_bytes(rows, k, "EncodedImage:blob"), np.uint8), cv2.IMREAD_COLOR)
        elif "Image:buffer" in rows.schema.names:
            stated = rows.column("Image:format")[k].as_py()[0]
            shape = stated["height"], stated["width"], CHANNELS[stated["color_model"]]
            data = _bytes(rows, k, "Image:buffer")
            pixels = np.frombuffer(data, np.uint8 if len(data) == np.prod(shape) else np.uint16).reshape(shape)
            image = np.repeat(to_uint8(pixels), 3 // shape[2], axis=2)
        elif "VideoStream:sample" in rows.schema.names:
            image = None if self._shown is None else self._shown.to_ndarray(format="bgr24")
        elif self._next is not None or self._shown is not None:
            time_ns = rows.column("VideoFrameReference:timestamp")[k].as_py()[0]
            while self._next is not None and round((self._next.time or 0) * 1e9) <= time_ns + 500:
                self._shown, self._next = self._next, next(self._video, None)
            image = self._shown.to_ndarray(format="bgr24")
        return None if image is None else np.asarray(image, np.uint8)


def _bytes(rows: Any, k: int, name: str) -> bytes:
    return rows.column(name)[k].values[0].values.to_numpy().tobytes()  # type: ignore[no-any-return]


def _strips(rows: Any, k: int) -> Strips:
    lists = rows.column("LineStrips2D:strips")[k].values
    if lists is None or not len(lists):
        return Strips([], np.zeros((0, 3), np.uint8), np.zeros(0, int))
    points = lists.flatten().flatten().to_numpy(zero_copy_only=False).reshape(-1, 2) - CORNER
    colours = _column(rows, k, "LineStrips2D:colors", 0xFFFFFFFF, len(lists)).astype(np.uint32)
    radii = _column(rows, k, "LineStrips2D:radii", -0.75, len(lists))
    return Strips(
        np.split(points, np.cumsum(lists.value_lengths().to_numpy())[:-1]),
        np.stack([colours >> shift & 255 for shift in (24, 16, 8)], axis=1).astype(np.uint8),
        np.maximum(np.floor(np.where(radii < 0, -WIDE_POINTS, 2) * radii), 1).astype(int),
    )


def _column(rows: Any, k: int, name: str, default: float, count: int) -> NDArray[Any]:
    """One value for each strip: Rerun lets the last one stand for all that follow."""
    found = rows.column(name)[k].as_py() if name in rows.schema.names else None
    values = np.array(found or [default])
    return values[np.minimum(np.arange(count), len(values) - 1)]

"""What is sent for every frame: one MessagePack map, `frontend.LineTracks` with all its fields, and back, exactly.

docs/backends.md describes it field by field, for programs in other languages. Within a version fields are only added,
and receivers pass over those that they do not know; any other change makes a new version, which they refuse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from airline.errors import AirLineError, InputError
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks, TrackState
from logs.tracks.json import Camera, Int, Size, camera_fields

T = TypeVar("T")

VERSION = 1
MAX_BYTES = 1 << 24  # a hundred thousand lines

_ROWS = {  # of the arrays with a row per track seen: dtype, little-endian, and shape of a row; -1 is any length
    "ids": ("<i8", ()),
    "segments_px": ("<f4", (2, 2)),
    "segments_normalized": ("<f4", (2, 2)),
    "observed_px": ("<f4", (2, 2)),
    "covariances": ("<f4", (2, 2)),
    "scores": ("<f4", ()),
    "descriptors": ("<f4", (-1,)),
    "states": ("|u1", ()),
    "ages": ("<i4", ()),
    "hits": ("<i4", ()),
    "line_indices": ("<i4", ()),
    "fragment_of": ("<i8", ()),
}
_LOST = {"lost_ids": ("<i8", ()), "lost_segments_px": ("<f4", (2, 2))}
_ENDED = {"ended_ids": ("<i8", ())}
ARRAYS = {**_ROWS, **_LOST, **_ENDED}


@dataclass(frozen=True)
class LiveTracks:
    """One message of a stream.

    Attributes:
        stream: of the publisher's run, another number for every run; track ids are unique within it.
        sequence: number of the message in its stream, from 0.
        name: of the input.
        sent_ns: wall-clock time when it was sent.
        read_ns: wall-clock time when the frame had been read, 0 where unknown.
        image_size: (width, height) of the frame, px.
        tracks: of the frame; None in the last message of a stream.
    """

    stream: int
    sequence: int
    name: str
    sent_ns: int
    read_ns: int = 0
    image_size: tuple[int, int] = (0, 0)
    tracks: LineTracks | None = None


class _Array(msgspec.Struct):
    dtype: str
    shape: tuple[Size, ...]
    data: bytes

    def read(self, dtype: str, row: tuple[int, ...], rows: int) -> NDArray[Any]:
        """The array; raises ValueError where it is another than it has to be."""
        shape = (rows, *row) if -1 not in row else (rows, *self.shape[1:2])
        if self.dtype != dtype or self.shape != shape or len(shape) != len(row) + 1:
            raise ValueError(f"it is {self.dtype} {list(self.shape)}, not {dtype} {[rows, *row]}")
        if len(self.data) != np.dtype(dtype).itemsize * math.prod(shape):
            raise ValueError(f"it has {len(self.data)} bytes, which is not its shape's number")
        return np.frombuffer(self.data, dtype).reshape(shape).astype(np.dtype(dtype).newbyteorder("="))


class _Version(msgspec.Struct):
    version: int


class _Envelope(msgspec.Struct):
    type: Literal["tracks", "end"]
    stream: Int
    sequence: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    name: str
    sent_ns: Int


class _Tracks(_Envelope):
    read_ns: Int
    frame_index: Int
    stamp_ns: Int
    image_size: tuple[Size, Size]
    camera: Camera | None
    reset: str | None
    arrays: dict[str, _Array]

    def model(self) -> LineTracks:
        """The tracks; raises ValueError for arrays that are missing or do not fit, ConfigError for an odd camera."""
        found: dict[str, NDArray[Any]] = {}
        for fields in (_ROWS, _LOST, _ENDED):
            rows = (self._array(next(iter(fields))).shape or (0,))[0]  # as many as there are ids
            for name, (dtype, row) in fields.items():
                try:
                    found[name] = self._array(name).read(dtype, row, rows)
                except ValueError as error:
                    raise ValueError(f"array '{name}': {error}") from None
        del found["segments_normalized"]  # it follows from the camera
        if not np.isin(found["states"], list(TrackState)).all():
            raise ValueError("array 'states': unknown state")
        camera = None if self.camera is None else self.camera.model()
        return LineTracks(self.frame_index, self.stamp_ns, **found, camera=camera, reset=self.reset)

    def _array(self, name: str) -> _Array:
        if name not in self.arrays:
            raise ValueError(f"array '{name}' is missing")
        return self.arrays[name]


_encoder = msgspec.msgpack.Encoder()


def encode_frame(result: FrameResult, *, stream: int, sequence: int, name: str, sent_ns: int) -> bytes:
    """The message of one frame; see `LiveTracks` for the arguments."""
    tracks = result.tracks
    height, width = result.frame.image.shape[:2]
    normalized = tracks.segments_normalized
    arrays = {key: getattr(tracks, key) for key in ARRAYS}
    if normalized is None:
        arrays["segments_normalized"] = np.full((len(tracks), 2, 2), np.nan, np.float32)
    return _encode(
        "tracks",
        stream=stream,
        sequence=sequence,
        name=name,
        sent_ns=sent_ns,
        read_ns=result.read_ns,
        frame_index=int(tracks.frame_index),
        stamp_ns=int(tracks.stamp_ns),
        image_size=(width, height),
        camera=camera_fields(tracks.camera),
        reset=tracks.reset,
        arrays={
            key: {"dtype": dtype, "shape": arrays[key].shape, "data": np.asarray(arrays[key], dtype).tobytes()}
            for key, (dtype, _) in ARRAYS.items()
        },
    )


def encode_end(*, stream: int, sequence: int, name: str, sent_ns: int) -> bytes:
    """The message that ends a stream."""
    return _encode("end", stream=stream, sequence=sequence, name=name, sent_ns=sent_ns)


def decode(data: bytes) -> LiveTracks:
    """The inverse of `encode_frame` and `encode_end`, for bytes of anybody.

    Raises:
        InputError: no such message, one of another version, or one whose parts do not fit each other.
    """
    if len(data) > MAX_BYTES:
        raise InputError(f"not a valid message of a line stream: it has more than {MAX_BYTES} bytes")
    try:
        version = _decoded(data, _Version).version
        if version != VERSION:
            raise InputError(
                f"the stream speaks version {version} of the protocol and this program version {VERSION}: "
                "use the same airline-frontend on both sides"
            )
        head = _decoded(data, _Envelope)
        envelope = (head.stream, head.sequence, head.name, head.sent_ns)
        if head.type == "end":
            return LiveTracks(*envelope)
        body = _decoded(data, _Tracks)
        return LiveTracks(*envelope, body.read_ns, body.image_size, body.model())
    except InputError:
        raise
    except (msgspec.MsgspecError, ValueError, RecursionError, AirLineError) as error:
        raise InputError(f"not a valid message of a line stream: {error}") from error


def _encode(kind: str, *, name: str, **fields: Any) -> bytes:
    readable = name.encode("utf-8", "replace").decode()  # a file's name need not be text
    return _encoder.encode({"version": VERSION, "type": kind, "name": readable, **fields})


def _decoded(data: bytes, kind: type[T]) -> T:
    return msgspec.msgpack.decode(data, type=kind)

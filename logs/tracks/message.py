"""What is sent for every frame: one MessagePack map, `frontend.LineTracks` with all its fields, and back, exactly.

docs/protocol.md describes it for programs in other languages. Within a version fields are only added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from airline.errors import AirLineError, InputError
from frontend.fields import ROWS, Field
from frontend.protocols import FrameResult
from frontend.tracks import DERIVED, FIELDS, LineTracks
from logs.tracks.json import Camera, Int, Size, assembled

VERSION = 1
MAX_BYTES = 1 << 24  # eighty thousand lines

ARRAYS = (*FIELDS, *DERIVED)  # the latter follow from the camera, but not every receiver can undistort


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
        stride: the frames are every stride-th of their source, but for those that could not be read or were dropped.
    """

    stream: int
    sequence: int
    name: str
    sent_ns: int
    read_ns: int = 0
    image_size: tuple[int, int] = (0, 0)
    tracks: LineTracks | None = None
    stride: int = 1


class _Array(msgspec.Struct):
    dtype: str
    shape: tuple[Size, ...]
    data: bytes

    def read(self, field: Field, rows: int) -> NDArray[Any]:
        """The array; raises ValueError where it is another than it has to be."""
        dtype, shape = (
            field.dtype.newbyteorder("<"),
            (rows, *(self.shape[1:2] if field.shape == (-1,) else field.shape)),
        )
        if self.dtype != dtype.str or self.shape != shape or len(shape) != 1 + len(field.shape):
            raise ValueError(f"it is {self.dtype} {list(self.shape)}, not {dtype.str} {[rows, *field.shape]}")
        if len(self.data) != dtype.itemsize * math.prod(shape):
            raise ValueError(f"it has {len(self.data)} bytes, which is not its shape's number")
        return np.frombuffer(self.data, dtype).reshape(shape).astype(field.dtype)


class _Version(msgspec.Struct):
    version: int


class _Envelope(_Version):
    type: Literal["tracks", "end"]
    name: str
    stream: Int
    sequence: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    sent_ns: Int


class _Tracks(_Envelope):
    read_ns: Int
    frame_index: Int
    stamp_ns: Int
    image_size: tuple[Size, Size]
    camera: Camera | None
    reset: str | None
    arrays: dict[str, _Array]
    stride: Annotated[int, Meta(ge=1, le=2**63 - 1)] = 1

    def model(self) -> LineTracks:
        """The tracks; raises ValueError for arrays that do not fit, ConfigError for an odd camera."""
        counts = {rows: (self.arrays[ids].shape or (0,))[0] for rows, (_, ids) in ROWS.items() if ids in self.arrays}
        found = {}
        for field in FIELDS:
            if field.name in self.arrays and field.rows in counts:
                try:
                    found[field.name] = self.arrays[field.name].read(field, counts[field.rows])
                except ValueError as error:
                    raise ValueError(f"array '{field.name}': {error}") from None
        camera = None if self.camera is None else self.camera.model()
        return assembled(self.frame_index, self.stamp_ns, found, camera, self.reset)


_encoder = msgspec.msgpack.Encoder()


def encode(
    result: FrameResult | None, *, stream: int, sequence: int, name: str, sent_ns: int, stride: int = 1
) -> bytes:
    """The message of one frame, or without one that which ends a stream; see `LiveTracks` for the other arguments."""
    readable = name.encode("utf-8", "replace").decode()  # a file's name need not be text
    envelope = (readable, stream, sequence, sent_ns)
    if result is None:
        return _encoder.encode(_Envelope(VERSION, "end", *envelope))
    tracks, (height, width) = result.tracks, result.frame.image.shape[:2]
    arrays = {}
    for field in ARRAYS:
        dtype, array = field.dtype.newbyteorder("<"), getattr(tracks, field.name)
        if array is None:
            array = np.full((len(getattr(tracks, ROWS[field.rows][1])), *field.shape), np.nan)
        arrays[field.name] = _Array(dtype.str, array.shape, np.asarray(array, dtype).tobytes())
    message = _Tracks(
        *(VERSION, "tracks", *envelope, result.read_ns, int(tracks.frame_index), int(tracks.stamp_ns)),
        *((width, height), Camera.of(tracks.camera), tracks.reset, arrays, stride),
    )
    return _encoder.encode(message)


def decode(data: bytes) -> LiveTracks:
    """The inverse of `encode`; raises InputError: no such message, of another version, or its parts do not fit."""
    if len(data) > MAX_BYTES:
        raise InputError(f"not a valid message of a line stream: it has more than {MAX_BYTES} bytes")
    try:
        version = msgspec.msgpack.decode(data, type=_Version).version
        if version != VERSION:
            raise InputError(
                f"the stream speaks version {version} of the protocol and this program version {VERSION}: "
                "use the same airline-frontend on both sides"
            )
        head = msgspec.msgpack.decode(data, type=_Envelope)
        envelope = (head.stream, head.sequence, head.name, head.sent_ns)
        if head.type == "end":
            return LiveTracks(*envelope)
        body = msgspec.msgpack.decode(data, type=_Tracks)
        return LiveTracks(*envelope, body.read_ns, body.image_size, body.model(), body.stride)
    except InputError:
        raise
    except (msgspec.MsgspecError, ValueError, RecursionError, AirLineError) as error:
        raise InputError(f"not a valid message of a line stream: {error}") from error

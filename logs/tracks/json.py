"""Tracked lines as JSON: `frontend.LineTracks` with all its fields, and back, exactly.

Written by orjson, which gives every float32 the shortest text that reads back as the same number. JSON has no NaN:
null stands for it. The schema, for people and for programs, is in `logs.tracks.schema`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import orjson
from msgspec import Meta
from numpy.typing import NDArray

from airline.errors import AirLineError, InputError
from frontend.camera.model import CameraModel
from frontend.tracks import LineTracks, TrackState

SECOND_NS = 1_000_000_000
_LARGEST = 3.4028235e38  # the largest float32 in its shortest form, which is a little more than it

Int = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
Count = Annotated[int, Meta(ge=-(2**31), le=2**31 - 1)]
Size = Annotated[int, Meta(ge=0, le=2**31 - 1)]
State = Annotated[int, Meta(ge=int(min(TrackState)), le=int(max(TrackState)))]
Real = Annotated[float, Meta(ge=-_LARGEST, le=_LARGEST)] | None
Pair = tuple[Real, Real]
Square = tuple[Pair, Pair]


class Camera(msgspec.Struct):
    """The fields of `CameraModel`."""

    width: Annotated[int, Meta(gt=0, le=2**31 - 1)]
    height: Annotated[int, Meta(gt=0, le=2**31 - 1)]
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Literal["none", "radial-tangential", "equidistant"]
    coefficients: list[float]

    def model(self) -> CameraModel:
        """The camera; raises ConfigError where the numbers make none."""
        fields = (self.width, self.height, self.fx, self.fy, self.cx, self.cy, self.distortion)
        return CameraModel(*fields, np.array(self.coefficients, np.float64))


class Time(msgspec.Struct):
    """Seconds, rounded down, and the nanoseconds on top."""

    sec: Annotated[int, Meta(ge=-(2**63) // SECOND_NS, le=(2**63 - 1) // SECOND_NS)]
    nsec: Annotated[int, Meta(ge=0, lt=SECOND_NS)]


class Tracks(msgspec.Struct):
    """The fields of `LineTracks`."""

    timestamp: Time
    frame_index: Int
    ids: list[Int]
    segments_px: list[Square]
    observed_px: list[Square]
    covariances: list[Square]
    scores: list[Real]
    descriptors: list[list[Real]]
    descriptor_length: Size
    states: list[State]
    ages: list[Count]
    hits: list[Count]
    line_indices: list[Count]
    fragment_of: list[Int]
    lost_ids: list[Int]
    lost_segments_px: list[Square]
    ended_ids: list[Int]
    camera: Camera | None
    reset: str | None

    def model(self) -> LineTracks:
        """The tracks; raises ValueError where lengths disagree, ConfigError for a camera that is none."""
        n = len(self.ids)
        rows = (
            *(self.segments_px, self.observed_px, self.covariances, self.scores, self.descriptors),
            *(self.states, self.ages, self.hits, self.line_indices, self.fragment_of),
        )
        if any(len(row) != n for row in rows) or len(self.lost_ids) != len(self.lost_segments_px):
            raise ValueError("its arrays have different lengths")
        if any(len(row) != self.descriptor_length for row in self.descriptors):
            raise ValueError("its descriptors have different lengths")
        stamp_ns = self.timestamp.sec * SECOND_NS + self.timestamp.nsec
        if not -(2**63) <= stamp_ns < 2**63:
            raise ValueError("its timestamp is out of range")
        return LineTracks(
            frame_index=self.frame_index,
            stamp_ns=stamp_ns,
            ids=np.array(self.ids, np.int64),
            segments_px=_floats(self.segments_px, n, 2, 2),
            observed_px=_floats(self.observed_px, n, 2, 2),
            covariances=_floats(self.covariances, n, 2, 2),
            scores=_floats(self.scores, n),
            descriptors=_floats(self.descriptors, n, self.descriptor_length),
            states=np.array(self.states, np.uint8),
            ages=np.array(self.ages, np.int32),
            hits=np.array(self.hits, np.int32),
            line_indices=np.array(self.line_indices, np.int32),
            fragment_of=np.array(self.fragment_of, np.int64),
            lost_ids=np.array(self.lost_ids, np.int64),
            lost_segments_px=_floats(self.lost_segments_px, len(self.lost_ids), 2, 2),
            ended_ids=np.array(self.ended_ids, np.int64),
            camera=None if self.camera is None else self.camera.model(),
            reset=self.reset,
        )


_decoder = msgspec.json.Decoder(Tracks)


def camera_fields(camera: CameraModel | None) -> dict[str, Any] | None:
    """What JSON holds of a camera."""
    if camera is None:
        return None
    return {
        "width": int(camera.width),
        "height": int(camera.height),
        **{name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")},
        "distortion": camera.distortion,
        "coefficients": [float(value) for value in camera.coefficients],
    }


def encode_tracks(tracks: LineTracks) -> bytes:
    """One frame's tracks as a JSON object, in UTF-8."""
    sec, nsec = divmod(int(tracks.stamp_ns), SECOND_NS)
    fields = {
        "timestamp": {"sec": sec, "nsec": nsec},
        "frame_index": int(tracks.frame_index),
        "ids": tracks.ids,
        "segments_px": tracks.segments_px,
        "observed_px": tracks.observed_px,
        "covariances": tracks.covariances,
        "scores": tracks.scores,
        "descriptors": tracks.descriptors,
        "descriptor_length": tracks.descriptors.shape[1],
        "states": tracks.states,
        "ages": tracks.ages,
        "hits": tracks.hits,
        "line_indices": tracks.line_indices,
        "fragment_of": tracks.fragment_of,
        "lost_ids": tracks.lost_ids,
        "lost_segments_px": tracks.lost_segments_px,
        "ended_ids": tracks.ended_ids,
        "camera": camera_fields(tracks.camera),
        "reset": tracks.reset,
    }
    ordered = {
        name: np.ascontiguousarray(value) if isinstance(value, np.ndarray) else value for name, value in fields.items()
    }
    return orjson.dumps(ordered, option=orjson.OPT_SERIALIZE_NUMPY)


def decode_tracks(text: bytes | memoryview) -> LineTracks:
    """The inverse of `encode_tracks`.

    Raises:
        InputError: text that is no such object, or whose arrays do not fit each other.
    """
    try:
        return _decoder.decode(text).model()
    except (msgspec.MsgspecError, ValueError, RecursionError, AirLineError) as error:
        raise InputError(f"not a valid frontend.LineTracks: {error}") from error


def _floats(values: list[Any], *shape: int) -> NDArray[np.float32]:
    return np.array(values, np.float32).reshape(shape)  # None becomes NaN

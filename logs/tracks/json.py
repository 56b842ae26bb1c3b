"""Tracked lines as JSON: every field of `frontend.LineTracks`, and back, exactly; and the JSON schema of it.

orjson gives every float32 the shortest text that reads back as the same number. JSON has no NaN: null stands for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import orjson
from msgspec import Meta
from numpy.typing import NDArray

from airline.errors import AirLineError, InputError
from frontend.camera.model import CameraModel
from frontend.fields import ROWS, Field
from frontend.tracks import DERIVED, FIELDS, LineTracks, TrackState

SECOND_NS = 1_000_000_000
SCHEMA_NAME = "frontend.LineTracks"
CONVENTIONS = {
    "pixels": "x to the right, y down, the centre of the top-left pixel is (0, 0)",
    "segments": "[[x0, y0], [x1, y1]]; the order of the end points is kept along a track",
    "normalized": "undistorted coordinates (X / Z, Y / Z) on the plane z = 1 of the camera",
    "times": "nanoseconds of the sensor",
    "track ids": "integers that stay with a line over the frames and are never used again",
    "states": ", ".join(f"{state.value} {state.name.lower()}" for state in TrackState),
    "covariance": "of a line's errors: offset across itself at its middle (px, or of the plane), and angle (radians)",
    "disparity": "x in the left image minus x in the right one, in the same row",
    "metres": "in the frame of the rectified left camera: x to the right, y down, z forward",
    "schema version": "1",
}

Int = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
Size = Annotated[int, Meta(ge=0, le=2**31 - 1)]
_LARGEST = 3.4028235e38  # the largest float32 in its shortest form, which is a little more than it
_Real = Annotated[float, Meta(ge=-_LARGEST, le=_LARGEST)] | None


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
    baseline_m: float = 0.0
    disparity_offset: float = 0.0

    @classmethod
    def of(cls, camera: CameraModel | None) -> Camera | None:
        """What files hold of a camera."""
        if camera is None:
            return None
        fx, fy, cx, cy, *coefficients = map(float, (camera.fx, camera.fy, camera.cx, camera.cy, *camera.coefficients))
        pair = float(camera.baseline_m), float(camera.disparity_offset)
        return cls(int(camera.width), int(camera.height), fx, fy, cx, cy, camera.distortion, coefficients, *pair)

    def model(self) -> CameraModel:
        """The camera; raises ConfigError where the numbers make none."""
        fields = (self.width, self.height, self.fx, self.fy, self.cx, self.cy, self.distortion)
        return CameraModel(
            *fields,
            np.array(self.coefficients, np.float64),
            baseline_m=self.baseline_m,
            disparity_offset=self.disparity_offset,
        )


def assembled(
    frame_index: int, stamp_ns: int, arrays: Mapping[str, NDArray[Any]], camera: CameraModel | None, reset: str | None
) -> LineTracks:
    """The tracks of these parts: arrays with the dtype and rows of their fields, of which later ones may be missing.

    Raises:
        ValueError: an array is missing, or they do not fit each other.
    """
    complete: dict[str, Any] = {}
    for field in FIELDS:
        count = len(arrays.get(ROWS[field.rows][1], ()))
        if field.name in arrays:
            complete[field.name] = arrays[field.name]
        elif field.older is not None:
            complete[field.name] = np.full((count, *field.shape), field.older, field.dtype)
        else:
            raise ValueError(f"array '{field.name}' is missing")
        if len(complete[field.name]) != count:
            raise ValueError("its arrays have different lengths")
    if len(complete["right_hits"]) not in (0, len(complete["ids"])):
        raise ValueError("only some of its tracks have a right image")
    if (complete["states"] > max(TrackState)).any():
        raise ValueError("a track has an unknown state")
    return LineTracks(frame_index, stamp_ns, **complete, camera=camera, reset=reset)


def encode_tracks(tracks: LineTracks) -> bytes:
    """One frame's tracks as a JSON object, in UTF-8."""
    sec, nsec = divmod(int(tracks.stamp_ns), SECOND_NS)
    fields: dict[str, Any] = {"timestamp": {"sec": sec, "nsec": nsec}, "frame_index": int(tracks.frame_index)}
    for field in FIELDS:
        array = fields[field.name] = np.ascontiguousarray(getattr(tracks, field.name))
        if field.shape == (-1,):
            fields[_length_of(field)] = array.shape[1]
    fields |= {one.name: getattr(tracks, one.name) for one in DERIVED}
    fields |= {"camera": Camera.of(tracks.camera), "reset": tracks.reset}
    return orjson.dumps(fields, default=msgspec.to_builtins, option=orjson.OPT_SERIALIZE_NUMPY)


def decode_tracks(text: bytes | memoryview) -> LineTracks:
    """The inverse of `encode_tracks`; raises InputError: no such object, or its arrays do not fit each other."""
    try:
        found: Any = _decoder.decode(text)
        arrays = {field.name: _array(field, found) for field in FIELDS if getattr(found, field.name) is not None}
        stamp_ns = found.timestamp.sec * SECOND_NS + found.timestamp.nsec
        if stamp_ns >= 2**63:
            raise ValueError("its timestamp is out of range")
        camera = None if found.camera is None else found.camera.model()
        return assembled(found.frame_index, stamp_ns, arrays, camera, found.reset)
    except (msgspec.MsgspecError, ValueError, RecursionError, AirLineError) as error:
        raise InputError(f"not a valid {SCHEMA_NAME}: {error}") from error


def _array(field: Field, found: Any) -> NDArray[Any]:
    values, shape = getattr(found, field.name), field.shape
    if shape == (-1,):
        shape = (getattr(found, _length_of(field)),)
        if any(len(row) != shape[0] for row in values):
            raise ValueError(f"its {field.name} have different lengths")
    return np.array(values, field.dtype).reshape(len(values), *shape)  # None becomes NaN


def _length_of(field: Field) -> str:
    """The key that says how long rows of any length are, such as "descriptor_length"."""
    return f"{field.name.removesuffix('s')}_length"


def _members() -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Key, type and JSON schema of each array that is read back."""
    kind: Any
    for field in FIELDS:
        if field.dtype.kind == "f":
            kind = _Real
        elif field.dtype.kind == "b":
            kind = bool
        else:
            limits = np.iinfo(field.dtype)
            kind = Annotated[int, Meta(ge=int(limits.min), le=int(limits.max))]
        for size in reversed(field.shape):
            kind = list[kind] if size < 0 else tuple[(kind,) * size]  # type: ignore[misc]
        yield field.name, list[kind] | None, _schema(field)
        if field.shape == (-1,):
            yield _length_of(field), Size, {"type": "integer", "minimum": 0, "description": "C"}


def _schema(field: Field) -> dict[str, Any]:
    types = {"f": ["number", "null"], "b": "boolean"}
    items: dict[str, Any] = {"type": types.get(field.dtype.kind, "integer")}
    for size in reversed(field.shape):
        items = {"type": "array", **({} if size < 0 else {"minItems": size, "maxItems": size}), "items": items}
    kind = ["array", "null"] if field in DERIVED else "array"  # null without a camera or right image
    return {"type": kind, "items": items, "description": field.text}


def _object(description: str, properties: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"type": "object", "description": description, "required": [*properties], "properties": properties, **more}


class _Time(msgspec.Struct):
    """Seconds, rounded down, and the nanoseconds on top."""

    sec: Annotated[int, Meta(ge=-(2**63) // SECOND_NS, le=(2**63 - 1) // SECOND_NS)]
    nsec: Annotated[int, Meta(ge=0, lt=SECOND_NS)]


_MEMBERS: list[Any] = [("timestamp", _Time), ("frame_index", Int), ("camera", Camera | None), ("reset", str | None)]
_ARRAYS: list[Any] = [(name, kind) if kind is Size else (name, kind, None) for name, kind, _ in _members()]
_decoder = msgspec.json.Decoder(msgspec.defstruct("Tracks", [*_MEMBERS, *_ARRAYS], kw_only=True))

_PIXELS = {"type": "integer", "description": "of the image, px"}
_FOCAL = {"type": "number", "description": "focal length, px"}
_PRINCIPAL = {"type": "number", "description": "principal point, px from the centre of the top-left pixel"}
_LENS = ["none", "radial-tangential", "equidistant"]
_COEFFICIENTS = (
    "radial-tangential: k1, k2, p1, p2[, k3[, k4, k5, k6]] (plumb_bob, rational_polynomial); "
    "equidistant: k1, k2, k3, k4 (Kannala-Brandt)"
)
_CAMERA = {
    **{"width": _PIXELS, "height": _PIXELS, "fx": _FOCAL, "fy": _FOCAL, "cx": _PRINCIPAL, "cy": _PRINCIPAL},
    "distortion": {"type": "string", "enum": _LENS, "description": "model of the lens"},
    "coefficients": {"type": "array", "items": {"type": "number"}, "description": _COEFFICIENTS},
    "baseline_m": {"type": "number", "description": "how far right of it the rectified second camera is, m; 0: none"},
    "disparity_offset": {"type": "number", "description": "disparity of points at infinity, px"},
}
_TIME = {"sec": {"type": "integer"}, "nsec": {"type": "integer", "minimum": 0, "maximum": SECOND_NS - 1}}

_DESCRIBED = {
    "timestamp": _object("sensor time of the image", _TIME, title="time"),
    "frame_index": {"type": "integer", "description": "number of the frame in its source, from 0"},
    **{name: schema for name, _, schema in _members()},
    **{field.name: _schema(field) for field in DERIVED},
    "camera": _object("the camera, null where unknown", _CAMERA, type=["object", "null"]),
    "reset": {"type": ["string", "null"], "description": "why all earlier tracks ended before this frame"},
}


def _shown(schema: dict[str, Any]) -> bool:
    """Whether Foxglove and Lichtblick know the type; they refuse a topic that has one property of another.

    These are lists of lists and what may be null. They go into "patternProperties", where players do not look, and
    which say the same to everybody else.
    """
    kinds = [schema["type"], schema.get("items", {"type": ""})["type"]]
    return all(isinstance(kind, str) for kind in kinds) and kinds[1] != "array"


SCHEMA = _object(
    "Line segments tracked through the images of a camera: the tracks seen in one frame. Element k of every (N) array "
    f"speaks of the same track. Pixels: {CONVENTIONS['pixels']}. Null among numbers stands for NaN.",
    {name: schema for name, schema in _DESCRIBED.items() if _shown(schema)},
    patternProperties={f"^{name}$": schema for name, schema in _DESCRIBED.items() if not _shown(schema)},
    **{"required": [*_DESCRIBED], "$schema": "https://json-schema.org/draft/2020-12/schema", "title": SCHEMA_NAME},
)

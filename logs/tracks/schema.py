"""The JSON schema of `frontend.LineTracks`, and the conventions that every file with tracks states."""

from __future__ import annotations

from typing import Any

from frontend.tracks import TrackState

SCHEMA_NAME = "frontend.LineTracks"
SCHEMA_VERSION = 1

CONVENTIONS = {
    "pixels": "x to the right, y down, the centre of the top-left pixel is (0, 0)",
    "segments": "[[x0, y0], [x1, y1]]; the order of the end points is kept along a track",
    "normalized": "undistorted coordinates (X / Z, Y / Z) on the plane z = 1 of the camera",
    "times": "nanoseconds of the sensor",
    "track ids": "integers that stay with a line over the frames and are never used again",
    "states": ", ".join(f"{state.value} {state.name.lower()}" for state in TrackState),
    "covariance": "of the fused line's errors: offset across itself at its middle (px), and angle (radians)",
    "schema version": str(SCHEMA_VERSION),
}


def _array(items: dict[str, Any], description: str) -> dict[str, Any]:
    return {"type": "array", "items": items, "description": description}


def _square(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "minItems": 2, "maxItems": 2, "items": items}


_INTEGER: dict[str, Any] = {"type": "integer"}
_REAL: dict[str, Any] = {"type": ["number", "null"]}
_MATRIX = _square(_square(_REAL))

_CAMERA: dict[str, Any] = {
    "type": ["object", "null"],
    "description": "the camera, null where unknown",
    "required": ["width", "height", "fx", "fy", "cx", "cy", "distortion", "coefficients"],
    "properties": {
        "width": {"type": "integer", "description": "of the image, px"},
        "height": {"type": "integer", "description": "of the image, px"},
        "fx": {"type": "number", "description": "focal length, px"},
        "fy": {"type": "number", "description": "focal length, px"},
        "cx": {"type": "number", "description": "principal point, px from the centre of the top-left pixel"},
        "cy": {"type": "number", "description": "principal point, px from the centre of the top-left pixel"},
        "distortion": {
            "type": "string",
            "enum": ["none", "radial-tangential", "equidistant"],
            "description": "model of the lens",
        },
        "coefficients": _array(
            {"type": "number"},
            "radial-tangential: k1, k2, p1, p2[, k3[, k4, k5, k6]] (plumb_bob, rational_polynomial); "
            "equidistant: k1, k2, k3, k4 (Kannala-Brandt)",
        ),
    },
}

_FIELDS: dict[str, dict[str, Any]] = {
    "timestamp": {
        "type": "object",
        "title": "time",
        "description": "sensor time of the image",
        "required": ["sec", "nsec"],
        "properties": {"sec": _INTEGER, "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999}},
    },
    "frame_index": {"type": "integer", "description": "number of the frame in its source, from 0"},
    "ids": _array(_INTEGER, "(N) track ids, ascending, never used again"),
    "segments_px": _array(_MATRIX, "(N, 2, 2) px, each track's line fused over the frames so far"),
    "observed_px": _array(_MATRIX, "(N, 2, 2) px, the lines as detected in this frame"),
    "covariances": _array(
        _MATRIX, "(N, 2, 2) of the fused line's errors: its offset across itself at its middle, px, and its angle, rad"
    ),
    "scores": _array(_REAL, "(N) scores of the detections in [0, 1]"),
    "descriptors": _array(_array(_REAL, "unit vector"), "(N, C) orientation descriptors"),
    "descriptor_length": {"type": "integer", "minimum": 0, "description": "C"},
    "states": _array(_INTEGER, f"(N) {CONVENTIONS['states']}"),
    "ages": _array(_INTEGER, "(N) frames since the track began, 0 in its first frame"),
    "hits": _array(_INTEGER, "(N) frames in which it was seen, this one included"),
    "line_indices": _array(_INTEGER, "(N) row of the detection among the frame's lines"),
    "fragment_of": _array(_INTEGER, "(N) id of the track whose line broke and left this piece, -1 for whole lines"),
    "lost_ids": _array(_INTEGER, "(L) confirmed tracks that were not seen in this frame and are still looked for"),
    "lost_segments_px": _array(_MATRIX, "(L, 2, 2) px, where these should be"),
    "ended_ids": _array(_INTEGER, "(E) tracks that ended with this frame"),
    "camera": _CAMERA,
    "reset": {"type": ["string", "null"], "description": "why all earlier tracks ended before this frame"},
}

SCHEMA: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": SCHEMA_NAME,
    "description": "Line segments tracked through the images of a camera: the tracks seen in one frame. Element k of "
    f"every (N) array speaks of the same track. Pixels: {CONVENTIONS['pixels']}. Null among numbers stands for NaN.",
    "type": "object",
    "required": list(_FIELDS),
    "properties": _FIELDS,
}

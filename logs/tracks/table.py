"""Tracked lines as a table: one row per observation, and back to `LineTracks`, exactly.

What belongs to a frame rather than to one of its observations stands in the first row of the frame and is null in the
others. Frames without any row, and the cameras, do not fit a table: `TableNotes` holds them, as JSON in the metadata.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import msgspec
import numpy as np
import orjson
import pyarrow as pa
from numpy.typing import NDArray

from airline.errors import AirLineError, InputError
from frontend.camera.model import CameraModel
from frontend.tracks import LineTracks
from logs.tracks.json import Camera, camera_fields, decode_tracks, encode_tracks
from logs.tracks.schema import CONVENTIONS

_PER_FRAME = "in the first row of each frame, null in the others: "

# name, type, nullable, unit, description
_COLUMNS: list[tuple[str, pa.DataType, bool, str, str]] = [
    ("stamp_ns", pa.int64(), False, "ns", "sensor time of the image"),
    ("frame", pa.int64(), False, "", "number of the frame in its source, from 0"),
    ("id", pa.int64(), False, "", "of the track; never used again"),
    *((f"{c}{e}", pa.float32(), False, "px", f"{c} of end point {e} of the fused line") for e in "01" for c in "xy"),
    *(
        (f"observed_{c}{e}", pa.float32(), False, "px", f"{c} of end point {e} as detected in this frame")
        for e in "01"
        for c in "xy"
    ),
    *(
        (f"{c}{e}", pa.float32(), True, "1", f"{d} of end point {e} of the fused line, normalized; null: no camera")
        for e in "01"
        for c, d in (("u", "X / Z"), ("v", "Y / Z"))
    ),
    ("score", pa.float32(), False, "", "of the detection, in [0, 1]"),
    ("age", pa.int32(), False, "frames", "since the track began, 0 in its first frame"),
    ("hits", pa.int32(), False, "frames", "in which the track was seen, this one included"),
    ("state", pa.uint8(), False, "", CONVENTIONS["states"]),
    ("fragment_of", pa.int64(), False, "", "id of the track whose line broke and left this piece, -1 for whole lines"),
    ("line_index", pa.int32(), False, "", "row of the detection among the frame's lines"),
    ("var_offset", pa.float32(), False, "px^2", "variance of the fused line's offset across itself at its middle"),
    ("cov_offset_angle", pa.float32(), False, "px rad", "covariance of the fused line's offset and angle"),
    ("var_angle", pa.float32(), False, "rad^2", "variance of the fused line's angle"),
    ("descriptor", pa.list_(pa.float32()), False, "", "orientation descriptor, a unit vector"),
    ("lost_ids", pa.list_(pa.int64()), True, "", _PER_FRAME + "confirmed tracks not seen but still looked for"),
    ("lost_segments", pa.list_(pa.float32()), True, "px", _PER_FRAME + "where these should be, x0, y0, x1, y1 each"),
    ("ended_ids", pa.list_(pa.int64()), True, "", _PER_FRAME + "tracks that ended with this frame"),
    ("reset", pa.string(), True, "", _PER_FRAME + "why all earlier tracks ended, null if they did not"),
]

SCHEMA = pa.schema(
    [
        pa.field(name, kind, nullable, {"unit": unit, "description": text} if unit else {"description": text})
        for name, kind, nullable, unit, text in _COLUMNS
    ],
    metadata={"title": "tracked line segments, one row per observation", **CONVENTIONS},
)

_POINTS = ("x0", "y0", "x1", "y1")


@dataclass
class TableNotes:
    """What a table cannot hold. Frames are numbered by their place in the stream, from 0, with or without rows.

    Attributes:
        cameras: from which place on which camera took the images.
        empty: frames without rows, by place.
    """

    cameras: dict[int, CameraModel | None] = field(default_factory=dict)
    empty: dict[int, LineTracks] = field(default_factory=dict)

    def to_metadata(self) -> dict[str, bytes]:
        """As JSON texts."""
        cameras = [{"from": place, "camera": camera_fields(camera)} for place, camera in self.cameras.items()]
        empty = [{"place": place, "tracks": orjson.Fragment(encode_tracks(t))} for place, t in self.empty.items()]
        return {"cameras": orjson.dumps(cameras), "frames without rows": orjson.dumps(empty)}

    def add(self, metadata: Any) -> None:
        """Add what `to_metadata` of another gave; raises InputError for anything else."""
        try:
            for note in msgspec.json.decode(metadata[b"cameras"], type=list[_CameraNote]):
                self.cameras[note.since] = None if note.camera is None else note.camera.model()
            for empty in msgspec.json.decode(metadata[b"frames without rows"], type=list[_EmptyNote]):
                self.empty[empty.place] = decode_tracks(bytes(empty.tracks))
                if len(self.empty[empty.place]):
                    raise InputError("a frame without rows has some")
        except (KeyError, TypeError, msgspec.MsgspecError, ValueError, RecursionError, AirLineError) as error:
            raise InputError(f"the notes on its frames are damaged: {error}") from error


class _CameraNote(msgspec.Struct, rename={"since": "from"}):
    since: int
    camera: Camera | None


class _EmptyNote(msgspec.Struct):
    place: int
    tracks: msgspec.Raw


def to_batch(frames: Sequence[LineTracks]) -> pa.RecordBatch:
    """The rows of some frames, those without rows left out."""
    frames = [tracks for tracks in frames if len(tracks)]
    counts = [len(tracks) for tracks in frames]

    def joined(name: str, dtype: Any, *shape: int) -> NDArray[Any]:
        parts = [np.asarray(getattr(tracks, name), dtype) for tracks in frames]
        return np.concatenate([np.empty((0, *shape), dtype), *parts])

    def repeated(name: str) -> NDArray[np.int64]:
        return np.repeat(np.array([getattr(tracks, name) for tracks in frames], np.int64), counts)

    def in_first_rows(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
        column: list[Any] = []
        for value, count in zip(values, counts, strict=True):
            column += [value, *[None] * (count - 1)]
        return pa.array(column, kind)

    points = {"": joined("segments_px", np.float32, 2, 2), "observed_": joined("observed_px", np.float32, 2, 2)}
    covariances = joined("covariances", np.float32, 2, 2)
    lengths = np.repeat(np.array([tracks.descriptors.shape[1] for tracks in frames], np.int64), counts)
    descriptors = [np.asarray(tracks.descriptors, np.float32).ravel() for tracks in frames]
    columns = {
        "stamp_ns": repeated("stamp_ns"),
        "frame": repeated("frame_index"),
        "id": joined("ids", np.int64),
        **{prefix + _POINTS[k]: value.reshape(-1, 4)[:, k] for prefix, value in points.items() for k in range(4)},
        **_normalized(frames, sum(counts)),
        "score": joined("scores", np.float32),
        "age": joined("ages", np.int32),
        "hits": joined("hits", np.int32),
        "state": joined("states", np.uint8),
        "fragment_of": joined("fragment_of", np.int64),
        "line_index": joined("line_indices", np.int32),
        "var_offset": covariances[:, 0, 0],
        "cov_offset_angle": covariances[:, 0, 1],
        "var_angle": covariances[:, 1, 1],
        "descriptor": pa.ListArray.from_arrays(
            pa.array(np.cumsum([0, *lengths]), pa.int32()), np.concatenate([np.empty(0, np.float32), *descriptors])
        ),
        "lost_ids": in_first_rows([tracks.lost_ids for tracks in frames], pa.list_(pa.int64())),
        "lost_segments": in_first_rows([tracks.lost_segments_px.ravel() for tracks in frames], pa.list_(pa.float32())),
        "ended_ids": in_first_rows([tracks.ended_ids for tracks in frames], pa.list_(pa.int64())),
        "reset": in_first_rows([tracks.reset for tracks in frames], pa.string()),
    }
    return pa.record_batch([pa.array(columns[name], kind) for name, kind, *_ in _COLUMNS], schema=SCHEMA)


def _normalized(frames: Sequence[LineTracks], rows: int) -> dict[str, pa.Array]:
    """The columns u0, v0, u1, v1."""
    points = np.zeros((rows, 4), np.float32)
    unknown = np.zeros(rows, np.bool_)
    end = 0
    for _, run in groupby(frames, key=lambda tracks: id(tracks.camera)):
        same = list(run)
        camera, segments = same[0].camera, [tracks.segments_px for tracks in same]
        start, end = end, end + sum(map(len, segments))
        if camera is None:
            unknown[start:end] = True
        else:
            points[start:end] = camera.normalize(np.concatenate(segments)).reshape(-1, 4)
    return {name: pa.array(points[:, k], mask=unknown) for k, name in enumerate(("u0", "v0", "u1", "v1"))}

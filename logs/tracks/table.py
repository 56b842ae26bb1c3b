"""Tracked lines as a table: one row per observation, and back to `LineTracks`, exactly.

What belongs to a frame rather than to one of its observations stands in the first row of the frame and is null in the
others; what a right image tells is null in the rows of frames without one. Frames without any row, and the cameras, do
not fit a table: `TableNotes` holds them, as JSON in the metadata.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import msgspec
import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from airline.errors import AirLineError, InputError
from frontend.camera.model import CameraModel
from frontend.fields import ROWS, Field
from frontend.tracks import DERIVED, FIELDS, LineTracks
from logs.tracks.json import CONVENTIONS, Camera, assembled, decode_tracks, encode_tracks

# The order of the first version's columns; fields that came later follow.
_ORDER = (
    *("ids", "segments_px", "observed_px", "segments_normalized", "scores", "ages", "hits", "states", "fragment_of"),
    *("line_indices", "covariances", "descriptors"),
)
_SEEN = sorted(
    (one for one in (*FIELDS, *DERIVED) if one.rows in ("seen", "right")),
    key=lambda one: _ORDER.index(one.name) if one.name in _ORDER else len(_ORDER),
)
_PER_FRAME = [one for one in (*FIELDS, *DERIVED) if one.rows not in ("seen", "right")]
_MOST_ROWS = 1_000_000  # of a frame
_DAMAGED = "its rows are damaged"


def _columns(one: Field) -> list[pa.Field]:
    kind, meaning = pa.from_numpy_dtype(one.dtype), one.meaning
    nullable = one in DERIVED or one.rows == "right"
    if one.words:
        kind, meaning = pa.string(), " or ".join(one.words)
    if one in _PER_FRAME:
        nullable, meaning = True, f"in the first row of each frame, null in the others: {meaning}"
    if one in _PER_FRAME or one.shape == (-1,):
        kind = pa.list_(kind)
    units = dict(one.numbers)  # a name that comes twice is one column
    return [
        pa.field(name, kind, nullable, {**({"unit": unit} if unit else {}), "description": meaning})
        for name, unit in units.items()
    ]


SCHEMA = pa.schema(
    [
        pa.field("stamp_ns", pa.int64(), False, {"unit": "ns", "description": "sensor time of the image"}),
        pa.field("frame", pa.int64(), False, {"description": "number of the frame in its source, from 0"}),
        *(column for one in (*_SEEN, *_PER_FRAME) for column in _columns(one)),
        pa.field("reset", pa.string(), True, {"description": "in the first row of each frame: why all tracks ended"}),
    ],
    metadata={
        "title": "tracked line segments, one row per observation",
        **{name: text for name, text in CONVENTIONS.items() if name != "states"},  # the column has words
    },
)
FRAME_COLUMNS = [name for one in _PER_FRAME for name, _ in one.numbers] + ["reset"]
RIGHT_COLUMNS = list(dict.fromkeys(name for one in _SEEN if one.rows == "right" for name, _ in one.numbers))
_WORDS = {one.numbers[0][0]: one for one in FIELDS if one.words}
_LATER = {name for one in FIELDS if one.older is not None for name, _ in one.numbers}
_RIGHT = {one.name for one in FIELDS if one.rows == "right"}
_DERIVED = {name for one in DERIVED for name, _ in one.numbers}


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
        cameras = [{"from": place, "camera": Camera.of(camera)} for place, camera in self.cameras.items()]
        empty = [
            {"place": place, "frame": int(t.frame_index), "stamp_ns": int(t.stamp_ns), "reset": t.reset}
            | {"tracks": orjson.Fragment(encode_tracks(t))}
            for place, t in self.empty.items()
        ]
        return {
            "cameras": orjson.dumps(cameras, default=msgspec.to_builtins),
            "frames without rows": orjson.dumps(empty),
        }

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

    def in_first_rows(values: Iterable[Any]) -> list[Any]:
        return [cell for value, count in zip(values, counts, strict=True) for cell in (value, *[None] * (count - 1))]

    columns: dict[str, Any] = {
        "stamp_ns": np.repeat(np.array([tracks.stamp_ns for tracks in frames], np.int64), counts),
        "frame": np.repeat(np.array([tracks.frame_index for tracks in frames], np.int64), counts),
        "reset": in_first_rows(tracks.reset for tracks in frames),
    }
    runs = groupby(frames, key=lambda tracks: (id(tracks.camera), len(tracks.right_hits) > 0))
    masks: dict[str, NDArray[np.bool_]] = {}
    by_camera = [_joined([*run]) for _, run in runs]
    for one in (*FIELDS, *DERIVED):
        names = [name for name, _ in one.numbers]
        sources = by_camera if one in DERIVED and one not in _PER_FRAME else frames
        absent = [_is_absent(tracks, one) for tracks in sources]
        if all(absent):
            columns |= {name: pa.nulls(sum(counts), SCHEMA.field(name).type) for name in names}
            continue
        if any(absent):
            masks |= dict.fromkeys(names, np.repeat(absent, [len(tracks) for tracks in sources]))
        values = [_values(tracks, one) for tracks in sources]
        flat = np.concatenate([np.empty(0, one.dtype), *(value.ravel() for value in values)])
        if one in _PER_FRAME:
            split = [value.reshape(-1, len(names)).T for value in values]
            columns |= {name: in_first_rows(parts[k] for parts in split) for k, name in enumerate(names)}
        elif one.shape == (-1,):
            ends = np.cumsum([0, *np.repeat(np.array([value.shape[1] for value in values], np.int64), counts)])
            columns[names[0]] = pa.ListArray.from_arrays(pa.array(ends, pa.int32()), flat)
        elif one.words:
            columns[names[0]] = pa.array(one.words).take(pa.array(flat))
        else:
            columns |= zip(names, flat.reshape(-1, len(names)).T, strict=True)
    arrays = [pa.array(columns[one.name], one.type, mask=masks.get(one.name)) for one in SCHEMA]
    return pa.record_batch(arrays, schema=SCHEMA)


def _joined(frames: list[LineTracks]) -> LineTracks:
    """Frames of one camera as one, for what is derived: lenses take the points of many as fast as those of one."""
    inputs = ["ids", "segments_px", "observed_px", "observed_covariances", *_RIGHT]
    arrays: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in frames]) for name in inputs}
    return replace(frames[0], **arrays)


def _is_absent(tracks: LineTracks, one: Field) -> bool:
    """Whether there is no such array, for want of a camera or of a right image."""
    return getattr(tracks, one.name) is None or (one.rows == "right" and len(tracks) > len(tracks.right_hits))


def _values(tracks: LineTracks, one: Field) -> NDArray[Any]:
    if _is_absent(tracks, one):
        count = len(getattr(tracks, ROWS["seen" if one.rows == "right" else one.rows][1]))
        return np.full((count, *one.shape), np.nan if one.dtype.kind == "f" else 0, one.dtype)
    return np.asarray(getattr(tracks, one.name), one.dtype)


def points_of(frames: Sequence[LineTracks]) -> pa.Table:
    """A row for each point of each frame, in columns named as those of a table of lines that hold lists of them."""
    counts = [len(tracks.point_ids) for tracks in frames]
    columns: dict[str, Any] = {
        "stamp_ns": np.repeat(np.array([tracks.stamp_ns for tracks in frames], np.int64), counts),
        "frame": np.repeat(np.array([tracks.frame_index for tracks in frames], np.int64), counts),
    }
    for one in (one for one in _PER_FRAME if one.rows == "points"):
        values = np.concatenate([_values(tracks, one) for tracks in frames])
        columns |= zip((name for name, _ in one.numbers), values.reshape(len(values), -1).T, strict=True)
    return pa.table(columns)


def needed_columns(schema: pa.Schema) -> list[str]:
    """What `read_frames` takes of a table; raises InputError for one that has not our columns."""
    needed = [name for name in SCHEMA.names if name not in _DERIVED and (name not in _LATER or name in schema.names)]
    for name in needed:
        types = [SCHEMA.field(name).type]
        if name in _WORDS:  # older files have the numbers
            types.append(pa.from_numpy_dtype(_WORDS[name].dtype))
        if schema.names.count(name) != 1 or schema.field(name).type not in types:
            raise InputError(
                f"it has no column '{name}' of type {SCHEMA.field(name).type}: these are no tracks of ours"
            )
    return needed


def read_frames(batches: Iterable[pa.RecordBatch], notes: TableNotes) -> Iterator[LineTracks]:
    """Frames of a table in the order in which they were written.

    Args:
        batches: the table's rows in order, cut anywhere, with the `needed_columns`.
        notes: on a frame they must be there before its rows are.

    Raises:
        InputError: rows or notes that this program did not write.
    """
    place, camera = 0, None
    for index, stamp_ns, arrays, reset in _frames_with_rows(batches):
        while place in notes.empty:
            yield notes.empty.pop(place)
            camera = notes.cameras.get(place, camera)
            place += 1
        camera = notes.cameras.get(place, camera)
        place += 1
        try:
            yield assembled(index, stamp_ns, arrays, camera, reset)
        except ValueError as error:
            raise InputError(f"{_DAMAGED}: {error}") from error
    for last in sorted(notes.empty):
        yield notes.empty.pop(last)


_Frame = tuple[int, int, dict[str, NDArray[Any]], str | None]


def _frames_with_rows(batches: Iterable[pa.RecordBatch]) -> Iterator[_Frame]:
    """Index, stamp, arrays and reset of every frame that has rows."""
    rest: list[pa.RecordBatch] = []
    for batch in batches:
        if not len(batch):
            continue
        starts = np.flatnonzero(batch.column("lost_ids").is_valid())
        if not rest and not (len(starts) and starts[0] == 0):
            raise InputError(f"{_DAMAGED}: the first is not the first of a frame")
        if len(starts):
            yield from _split(pa.Table.from_batches([*rest, batch.slice(0, starts[-1])]))
            rest = []
        rest.append(batch.slice(starts[-1] if len(starts) else 0))
        if sum(map(len, rest)) > _MOST_ROWS:
            raise InputError(f"{_DAMAGED}: a frame has more than {_MOST_ROWS} rows")
    if rest:
        yield from _split(pa.Table.from_batches(rest))


def _split(rows: pa.Table) -> Iterator[_Frame]:
    """Some whole frames."""
    columns = {name: rows.column(name).combine_chunks() for name in rows.column_names}
    for name, one in _WORDS.items():
        if pa.types.is_string(columns[name].type):
            unknown = int(np.iinfo(one.dtype).max)
            columns[name] = pc.index_in(columns[name], pa.array(one.words)).fill_null(unknown).cast(one.dtype.name)
    starts = np.flatnonzero(columns["lost_ids"].is_valid())
    frames, stamps = _numbers(columns["frame"]), _numbers(columns["stamp_ns"])
    fixed, open_rows, paired = {}, {}, np.zeros(len(rows), np.bool_)
    if "right_hits" in columns:  # not in older files
        paired = columns["right_hits"].is_valid().to_numpy(zero_copy_only=False)
    for one in FIELDS:
        names = [name for name, _ in one.numbers]
        if one in _PER_FRAME or names[0] not in columns:
            continue
        if one.shape == (-1,):
            lists = columns[names[0]]
            lengths = _numbers(lists.value_lengths())  # null for a list that is
            open_rows[one.name] = _numbers(lists.flatten()), lengths, np.concatenate([[0], np.cumsum(lengths)])
        else:
            known = paired if one.rows == "right" else True
            fixed[one.name] = np.stack([_numbers(columns[name], known) for name in names], 1).reshape(-1, *one.shape)
    whole = [one for one in _PER_FRAME if one not in DERIVED]  # journals have these too
    for start, end in zip(starts, [*starts, len(rows)][1:], strict=True):
        own = slice(start, end)
        if any(
            (values[own] != values[start]).any()
            for values in (frames, stamps, paired, *(o[1] for o in open_rows.values()))
        ):
            raise InputError(f"{_DAMAGED}: those of one frame disagree")
        arrays = {name: values[own].copy() for name, values in fixed.items() if paired[start] or name not in _RIGHT}
        for name, (values, lengths, ends) in open_rows.items():
            arrays[name] = values[ends[start] : ends[end]].reshape(end - start, lengths[start]).copy()
        for one in whole:
            lists = [_list(columns[name][start]) for name, _ in one.numbers if name in columns]
            if lists:
                arrays[one.name] = _rows(lists, one)
        yield int(frames[start]), int(stamps[start]), arrays, columns["reset"][start].as_py()


def _numbers(column: pa.Array, known: NDArray[np.bool_] | bool = True) -> NDArray[Any]:
    if column.null_count or known is not True:
        if (column.is_valid().to_numpy(zero_copy_only=False) != known).any():
            raise InputError(f"{_DAMAGED}: numbers are missing")
        column = column.fill_null(pa.scalar(0).cast(column.type))
    return column.to_numpy(zero_copy_only=False)  # type: ignore[no-any-return]


def _list(value: pa.ListScalar) -> NDArray[Any]:
    if not value.is_valid:
        raise InputError(f"{_DAMAGED}: lists are missing")
    return _numbers(value.values)


def _rows(lists: list[NDArray[Any]], one: Field) -> NDArray[Any]:
    """An array of a frame from its lists: one, or one for each number of a row."""
    if len({len(numbers) for numbers in lists}) > 1 or lists[0].size * len(lists) % int(np.prod(one.shape)):
        raise InputError(f"{_DAMAGED}: lines or points are not whole")
    return np.stack(lists, axis=1).reshape(-1, *one.shape)

"""Frames out of a table of observations: the inverse of `logs.tracks.table.to_batch`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from airline.errors import InputError
from frontend.tracks import LineTracks, TrackState
from logs.tracks.table import SCHEMA, TableNotes

COLUMNS = [name for name in SCHEMA.names if name not in ("u0", "v0", "u1", "v1")]  # these follow from the others

_MOST_ROWS = 1_000_000  # of a frame
_DAMAGED = "its rows are damaged"


def check_columns(schema: pa.Schema) -> None:
    """Refuse a table that has not our columns; raises InputError."""
    for name in COLUMNS:
        if schema.names.count(name) != 1 or schema.field(name).type != SCHEMA.field(name).type:
            raise InputError(
                f"it has no column '{name}' of type {SCHEMA.field(name).type}: these are no tracks of ours"
            )


def read_frames(batches: Iterable[pa.RecordBatch], notes: TableNotes) -> Iterator[LineTracks]:
    """Frames of a table in the order in which they were written.

    Args:
        batches: the table's rows in order, cut anywhere, with the columns `COLUMNS`.
        notes: what the table cannot hold; those on a frame must be there before its rows are.

    Raises:
        InputError: rows or notes that this program did not write.
    """
    place, camera = 0, None
    for fields in _frames_with_rows(batches):
        while place in notes.empty:
            yield notes.empty.pop(place)
            camera = notes.cameras.get(place, camera)
            place += 1
        camera = notes.cameras.get(place, camera)
        place += 1
        yield LineTracks(**fields, camera=camera)
    for last in sorted(notes.empty):
        yield notes.empty.pop(last)


def _frames_with_rows(batches: Iterable[pa.RecordBatch]) -> Iterator[dict[str, Any]]:
    """The fields of `LineTracks` for every frame that has rows."""
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


def _split(rows: pa.Table) -> Iterator[dict[str, Any]]:
    """The fields of `LineTracks` for each of some whole frames."""
    columns = {name: rows.column(name).combine_chunks() for name in COLUMNS}
    starts = np.flatnonzero(columns["lost_ids"].is_valid())
    ends = [*starts, len(rows)][1:]
    descriptors, lengths = _lists(columns["descriptor"])
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    arrays = {
        name: _numbers(column)
        for name, column in columns.items()
        if not pa.types.is_nested(column.type) and name != "reset"
    }
    points = np.stack([arrays[name] for name in ("x0", "y0", "x1", "y1")], axis=1).reshape(-1, 2, 2)
    observed = np.stack([arrays[f"observed_{name}"] for name in ("x0", "y0", "x1", "y1")], axis=1).reshape(-1, 2, 2)
    covariance = [arrays[name] for name in ("var_offset", "cov_offset_angle", "cov_offset_angle", "var_angle")]
    covariances = np.stack(covariance, axis=1).reshape(-1, 2, 2)
    if (arrays["state"] > max(TrackState)).any():
        raise InputError(f"{_DAMAGED}: a track has an unknown state")
    lost, ended, lost_points, reset = (columns[n] for n in ("lost_ids", "ended_ids", "lost_segments", "reset"))
    for start, end in zip(starts, ends, strict=True):
        own = slice(start, end)
        frame, stamp, length = arrays["frame"][own], arrays["stamp_ns"][own], lengths[own]
        if (frame != frame[0]).any() or (stamp != stamp[0]).any() or (length != length[0]).any():
            raise InputError(f"{_DAMAGED}: those of one frame disagree")
        lost_ids, lost_segments_px = _list(lost[start]), _list(lost_points[start])
        if lost_segments_px.size != 4 * lost_ids.size:
            raise InputError(f"{_DAMAGED}: lost tracks without their lines")
        yield {
            "frame_index": int(frame[0]),
            "stamp_ns": int(stamp[0]),
            "ids": arrays["id"][own].copy(),
            "segments_px": points[own].copy(),
            "observed_px": observed[own].copy(),
            "covariances": covariances[own].copy(),
            "scores": arrays["score"][own].copy(),
            "descriptors": descriptors[offsets[start] : offsets[end]].reshape(end - start, length[0]).copy(),
            "states": arrays["state"][own].copy(),
            "ages": arrays["age"][own].copy(),
            "hits": arrays["hits"][own].copy(),
            "line_indices": arrays["line_index"][own].copy(),
            "fragment_of": arrays["fragment_of"][own].copy(),
            "lost_ids": lost_ids,
            "lost_segments_px": lost_segments_px.reshape(-1, 2, 2),
            "ended_ids": _list(ended[start]),
            "reset": reset[start].as_py(),
        }


def _numbers(column: pa.Array) -> NDArray[Any]:
    if column.null_count:
        raise InputError(f"{_DAMAGED}: numbers are missing")
    return column.to_numpy()  # type: ignore[no-any-return]


def _lists(column: pa.ListArray) -> tuple[NDArray[Any], NDArray[Any]]:
    """All values, one list after the other, and the lists' lengths."""
    if column.null_count:
        raise InputError(f"{_DAMAGED}: descriptors are missing")
    return _numbers(column.flatten()), column.value_lengths().to_numpy()


def _list(value: pa.ListScalar) -> NDArray[Any]:
    if not value.is_valid:
        raise InputError(f"{_DAMAGED}: lists are missing")
    return _numbers(value.values).copy()

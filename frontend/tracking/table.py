"""What the tracker remembers of its tracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frontend.tracking.overlap import LineFeatures
from frontend.tracking.state import DEPTH

ENDS = 5  # frames whose end points are remembered


@dataclass(frozen=True)
class TrackTable:
    """Tracks as columns; row k of every array speaks of the same track, and ids ascend.

    Attributes:
        ids: (N,) int64.
        segments: (N, 2, 2) float32 px, fused, in the image that the tracker last used.
        depths: (N, 2) float32 inverse depths of both ends, with `covariances` (N, 4, 4) float32: see `state`.
        ends: (N, 2, K) float32 where along the segment the line began and ended the last times it was seen, the latest
            in the last column, from 0 at the segment's start to 1 at its end; NaN before the track began.
        descriptors: (N, C) float32 unit rows.
        profiles: (N, K) float32 lately, see `appearance`, and `first_profiles` when the track began.
        born: (N,) int64 index of the first frame.
        hits: (N,) int32 frames in which the track was seen.
        missed: (N,) int32 frames since it was last seen.
        visible: (N,) bool, seen in the image that the tracker last used.
        doubled: (N,) int32 frames in a row in which it lay on an older track.
        across: (N,) float32 px that the line moved across itself since the last frame.
        surprise: (N,) float32 recent mean of the squared innovation over what its covariance lets expect.
        fragment_of: (N,) int64 id of the track whose line this is a piece of, -1 for none.
    """

    ids: NDArray[np.int64]
    segments: NDArray[np.float32]
    depths: NDArray[np.float32]
    ends: NDArray[np.float32]
    covariances: NDArray[np.float32]
    descriptors: NDArray[np.float32]
    profiles: NDArray[np.float32]
    first_profiles: NDArray[np.float32]
    born: NDArray[np.int64]
    hits: NDArray[np.int32]
    missed: NDArray[np.int32]
    visible: NDArray[np.bool_]
    doubled: NDArray[np.int32]
    across: NDArray[np.float32]
    surprise: NDArray[np.float32]
    fragment_of: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def seen_parts(self) -> NDArray[np.float32]:
        """(N, 2, 2) float32 px, the parts of the segments that were seen last."""
        start, end = self.segments[:, :1], self.segments[:, 1:]
        return np.asarray(start + self.ends[:, :, -1:] * (end - start))

    @property
    def spread(self) -> NDArray[np.float32]:
        """(N,) float32 standard deviation of where each line is across itself, px, the larger one of its ends'."""
        return np.asarray(np.sqrt(np.maximum(self.covariances[:, 0, 0], self.covariances[:, 1, 1])))

    @property
    def features(self) -> LineFeatures:
        """The tracks as candidates for a pair."""
        return LineFeatures(self.segments, self.descriptors, self.profiles)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Every array by its name."""
        return {column.name: getattr(self, column.name) for column in fields(self)}

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> TrackTable:
        """Some of the tracks."""
        rows = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        return TrackTable(**{name: column.take(rows, axis=0) for name, column in self.columns().items()})

    def with_rows(self, rows: NDArray[np.bool_], values: Mapping[str, NDArray[Any]]) -> TrackTable:
        """A copy in which the masked rows of the named columns hold new values."""
        columns = self.columns()
        for name, value in values.items():
            columns[name] = columns[name].copy()
            columns[name][rows] = value
        return TrackTable(**columns)

    def append(self, other: TrackTable) -> TrackTable:
        """These tracks, then the others."""
        theirs = other.columns()
        return TrackTable(**{name: np.concatenate([column, theirs[name]]) for name, column in self.columns().items()})


def new_tracks(
    first_id: int, frame_index: int, lines: LineFeatures, covariances: NDArray[np.float32], parents: NDArray[np.int64]
) -> TrackTable:
    """A track for each of N lines that were seen for the first time; `parents` as in `fragment_of`."""
    count = len(lines.segments)
    ends = np.full((count, 2, ENDS), np.nan, np.float32)
    ends[:, :, -1] = 0, 1
    return TrackTable(
        ids=np.arange(first_id, first_id + count, dtype=np.int64),
        segments=lines.segments,
        depths=np.full((count, 2), DEPTH, np.float32),
        ends=ends,
        covariances=covariances,
        descriptors=lines.descriptors,
        profiles=lines.profiles,
        first_profiles=lines.profiles,
        born=np.full(count, frame_index, np.int64),
        hits=np.ones(count, np.int32),
        missed=np.zeros(count, np.int32),
        visible=np.ones(count, np.bool_),
        doubled=np.zeros(count, np.int32),
        across=np.zeros(count, np.float32),
        surprise=np.ones(count, np.float32),
        fragment_of=parents,
    )


def no_tracks(lines: LineFeatures) -> TrackTable:
    """An empty table for tracks of such lines."""
    none = lines.take(np.zeros(0, np.int32))
    return new_tracks(0, 0, none, np.zeros((0, 4, 4), np.float32), np.zeros(0, np.int64))

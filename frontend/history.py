"""Whole tracks, collected from the frames of a stream in bounded memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError, InputError
from frontend.tracks import LineTracks

# One observation, under the names of `Observations`; normalized is NaN without a camera.
_ROW = np.dtype(
    [
        ("frame_indices", np.int64),
        ("stamps_ns", np.int64),
        ("segments_px", np.float32, (2, 2)),
        ("observed_px", np.float32, (2, 2)),
        ("segments_normalized", np.float32, (2, 2)),
        ("scores", np.float32),
        ("has_camera", np.bool_),
    ]
)


@dataclass(frozen=True)
class Observations:
    """One track through time: T observations in time order, frames without the line left out.

    Attributes:
        track_id: the track.
        frame_indices: (T,) int64 `Frame.index`.
        stamps_ns: (T,) int64 sensor times, ns.
        segments_px: (T, 2, 2) float32 px, as fused up to that frame.
        observed_px: (T, 2, 2) float32 px, as detected in that frame alone: errors are independent of other frames.
        segments_normalized: (T, 2, 2) float32 `segments_px` undistorted on the plane z = 1; None if a camera was
            unknown.
        scores: (T,) float32.
        ended: whether the track will never be seen again.
    """

    track_id: int
    frame_indices: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    segments_px: NDArray[np.float32]
    observed_px: NDArray[np.float32]
    segments_normalized: NDArray[np.float32] | None
    scores: NDArray[np.float32]
    ended: bool

    def __len__(self) -> int:
        return len(self.frame_indices)


class TrackHistory:
    """The latest observations of the latest tracks, for backends that want tracks rather than frames.

    Memory is bounded by `max_tracks * max_frames` observations of about 250 bytes. A track of more than `max_frames`
    loses its oldest. Of more than `max_tracks` tracks those that ended first are dropped, then those not seen for
    longest; one that is seen again starts anew under its id.

    Args:
        max_frames: observations kept of each track.
        max_tracks: tracks kept, ended ones included until `pop_ended` takes them.

    Raises:
        ConfigError: a bound below 1.
    """

    def __init__(self, max_frames: int = 300, max_tracks: int = 2000) -> None:
        if max_frames < 1 or max_tracks < 1:
            raise ConfigError(f"a history keeps at least 1 frame of 1 track, not {max_frames} of {max_tracks}")
        self._max_frames = max_frames
        self._max_tracks = max_tracks
        self._live: dict[int, deque[np.void]] = {}  # the one not seen for longest comes first
        self._ended: dict[int, deque[np.void]] = {}  # in the order of their ends

    def __len__(self) -> int:
        return len(self._live) + len(self._ended)

    @property
    def ids(self) -> NDArray[np.int64]:
        """(K,) int64 ids of the tracks in the history, ascending."""
        return np.array(sorted([*self._live, *self._ended]), np.int64)

    def add(self, tracks: LineTracks) -> None:
        """Take the next frame's tracks."""
        if tracks.reset is not None:
            self._end(list(self._live))
        for track_id, row in zip(tracks.ids.tolist(), _rows(tracks), strict=True):
            observations = self._live.pop(track_id, None)
            if observations is None:
                observations = deque(maxlen=self._max_frames)
            observations.append(row)
            self._live[track_id] = observations
        self._end(tracks.ended_ids.tolist())
        while len(self) > self._max_tracks:
            oldest = self._ended or self._live
            del oldest[next(iter(oldest))]

    def observations_of(self, track_id: int) -> Observations:
        """One track as far as it is known.

        Raises:
            InputError: no such track in the history.
        """
        track_id = int(track_id)
        rows = self._live.get(track_id) or self._ended.get(track_id)
        if rows is None:
            raise InputError(
                f"track {track_id} is not in the history: it was not seen, was taken by pop_ended, or was dropped to "
                f"keep the history within {self._max_tracks} tracks"
            )
        return _observations(track_id, rows, track_id in self._ended)

    def tracks(self, at_least: int = 1) -> Iterator[Observations]:
        """The tracks with at least that many observations, by ascending id."""
        for track_id in self.ids.tolist():
            track = self.observations_of(track_id)
            if len(track) >= at_least:
                yield track

    def pop_ended(self) -> list[Observations]:
        """Take out the tracks that ended since the last call, in the order of their ends; they are then forgotten."""
        ended, self._ended = self._ended, {}
        return [_observations(track_id, rows, True) for track_id, rows in ended.items()]

    def _end(self, ids: list[int]) -> None:
        for track_id in ids:
            rows = self._live.pop(track_id, None)
            if rows is not None:
                self._ended[track_id] = rows


def _rows(tracks: LineTracks) -> list[np.void]:
    """One record per track, each with memory of its own, so that it does not hold on to the frame's arrays."""
    table = np.zeros(len(tracks), _ROW)
    table["frame_indices"], table["stamps_ns"], table["scores"] = tracks.frame_index, tracks.stamp_ns, tracks.scores
    table["segments_px"], table["observed_px"] = tracks.segments_px, tracks.observed_px
    normalized = tracks.segments_normalized
    table["has_camera"] = normalized is not None
    table["segments_normalized"] = np.nan if normalized is None else normalized
    return [row.copy() for row in table]


def _observations(track_id: int, rows: deque[np.void], ended: bool) -> Observations:
    table = np.array(rows, _ROW)
    columns: dict[str, Any] = {name: table[name].copy() for name in _ROW.names or ()}
    if not columns.pop("has_camera").all():
        columns["segments_normalized"] = None
    return Observations(track_id, ended=ended, **columns)

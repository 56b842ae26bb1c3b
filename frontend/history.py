"""Whole tracks, collected from the frames of a stream in bounded memory, and what was seen before a confirmation."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError, InputError
from frontend.tracks import DERIVED, FIELDS, LineTracks

log = logging.getLogger(__name__)

PATIENCE = 300  # frames; what was not seen for longer has ended, and the message that said so was lost


@dataclass(frozen=True)
class Observations:
    """One track through time: T observations in time order, frames without the line left out.

    What is on the plane z = 1 is None if a camera was unknown.

    Attributes:
        track_id: the track.
        frame_indices, stamps_ns: (T,) int64 `Frame.index`, and sensor times, ns.
        segments_px, observed_px, observed_covariances, scores, measured, segments_normalized, observed_normalized,
            observed_lines, observed_line_covariances: (T, ...) as of `LineTracks`, whose row it was.
        ended: whether the track will never be seen again.
    """

    track_id: int
    frame_indices: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    segments_px: NDArray[np.float32]
    observed_px: NDArray[np.float32]
    observed_covariances: NDArray[np.float32]
    scores: NDArray[np.float32]
    measured: NDArray[np.bool_]
    segments_normalized: NDArray[np.float32] | None
    observed_normalized: NDArray[np.float32] | None
    observed_lines: NDArray[np.float32] | None
    observed_line_covariances: NDArray[np.float32] | None
    ended: bool

    def __len__(self) -> int:
        return len(self.frame_indices)


# One observation, under the names of `Observations`; what is derived is NaN without a camera.
_KEPT = [one for one in (*FIELDS, *DERIVED) if one.name in Observations.__annotations__]
_ROW = np.dtype(
    [
        ("frame_indices", np.int64),
        ("stamps_ns", np.int64),
        ("has_camera", np.bool_),
        *((one.name, one.dtype, one.shape) for one in _KEPT),
    ]
)


class TrackHistory:
    """The latest observations of the latest tracks, for backends that want tracks rather than frames.

    Memory is bounded by `max_tracks * max_frames` observations of about 320 bytes. A track of more than `max_frames`
    loses its oldest. Of more than `max_tracks` tracks those that ended first are dropped, then those not seen for
    longest; one that is seen again starts anew under its id. The first time there is a warning; `dropped` counts.

    Args:
        max_frames: observations kept of each track.
        max_tracks: tracks kept, ended ones included until `pop_ended` takes them.

    Raises:
        ConfigError: a bound below 1.
    """

    def __init__(self, max_frames: int = 300, max_tracks: int = 20_000) -> None:
        if max_frames < 1 or max_tracks < 1:
            raise ConfigError(f"a history keeps at least 1 frame of 1 track, not {max_frames} of {max_tracks}")
        self._max_frames = max_frames
        self._max_tracks = max_tracks
        self._live: dict[int, deque[np.void]] = {}  # the one not seen for longest comes first
        self._ended: dict[int, deque[np.void]] = {}  # in the order of their ends
        self.dropped = 0

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
            if not self.dropped:
                log.warning("a history of %d tracks is full: raise max_tracks, or call pop_ended", self._max_tracks)
            self.dropped += 1

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


class Confirmations:
    """Hands the earlier observations of a track on with the frame that confirms it, in any stream of `LineTracks`."""

    def __init__(self) -> None:
        self._waiting: dict[int, list[tuple[int, LineTracks, int]]] = {}  # the one not seen for longest comes first
        self._frames = 0

    def add(self, tracks: LineTracks) -> LineTracks:
        """The next frame's tracks, with their `history`."""
        tracks = replace(tracks, earlier=()) if tracks.earlier else tracks
        waiting, self._frames = self._waiting, self._frames + 1
        if tracks.reset is not None:
            waiting.clear()
        confirmed, ids = tracks.confirmed, tracks.ids
        earlier: dict[int, tuple[LineTracks, list[int]]] = {}
        for track_id in waiting.keys() & set(ids[confirmed].tolist()):
            for number, frame, row in waiting.pop(track_id):
                earlier.setdefault(number, (frame, []))[1].append(row)
        rows = np.flatnonzero(~confirmed)
        for row, track_id in zip(rows.tolist(), ids[rows].tolist(), strict=True):
            sightings = waiting[track_id] = waiting.pop(track_id, [])
            sightings.append((self._frames, tracks, row))
        for track_id in tracks.ended_ids.tolist():
            waiting.pop(track_id, None)
        while waiting and next(iter(waiting.values()))[-1][0] < self._frames - PATIENCE:
            del waiting[next(iter(waiting))]
        if not earlier:
            return tracks
        return replace(tracks, earlier=tuple((frame, np.sort(rows)) for _, (frame, rows) in sorted(earlier.items())))


def _rows(tracks: LineTracks) -> list[np.void]:
    """One record per track, each with memory of its own, so that it does not hold on to the frame's arrays."""
    table = np.zeros(len(tracks), _ROW)
    table["frame_indices"], table["stamps_ns"] = tracks.frame_index, tracks.stamp_ns
    table["has_camera"] = tracks.camera is not None
    for one in _KEPT:
        values = getattr(tracks, one.name)
        table[one.name] = np.nan if values is None else values
    return [row.copy() for row in table]


def _observations(track_id: int, rows: deque[np.void], ended: bool) -> Observations:
    table = np.array(rows, _ROW)
    columns: dict[str, Any] = {name: table[name].copy() for name in _ROW.names or ()}
    if not columns.pop("has_camera").all():
        columns |= dict.fromkeys(one.name for one in _KEPT if one in DERIVED)
    return Observations(track_id, ended=ended, **columns)

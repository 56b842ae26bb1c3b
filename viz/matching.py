"""Which lines of two runs are the same, and which tracks."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np
from numpy.typing import NDArray

from airline.evaluation.repeatability import MAX_ANGLE, MAX_DISTANCE, MIN_OVERLAP, measure_pairs
from frontend.tracking.assignment import assign

MEMORY = 15  # matches of a track that decide which track of the other run it is
FORGET_FRAMES = 300  # a track that was not seen for so long is over

Segments = NDArray[np.float32]


def match_lines(first: Segments, second: Segments) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """One-to-one pairs of lines that lie over each other: near, alike in direction, and along each other.

    The measures and their bounds are those of the repeatability, see `measure_pairs`; of all ways to pair the lines,
    that with the most overlap in total is taken, nearer pairs counting more.

    Args:
        first: (N, 2, 2) px.
        second: (M, 2, 2) px, in the same image.

    Returns:
        (K,) rows of the first, ascending, (K,) rows of the second, and (K,) distances, px.
    """
    none = np.zeros(0, np.int64)
    if not len(first) or not len(second):
        return none, none, np.zeros(0)
    with np.errstate(divide="ignore", invalid="ignore"):  # lines without length, and NaN, match nothing
        distance, overlap, cosine = measure_pairs(first.astype(np.float64), second.astype(np.float64))
        possible = (distance <= MAX_DISTANCE) & (overlap >= MIN_OVERLAP) & (cosine >= np.cos(MAX_ANGLE))
        votes = np.where(possible, overlap * (1 - 0.9 * distance / MAX_DISTANCE), 0)
    chosen = assign(votes.astype(np.float32), 1e-6)
    rows = np.flatnonzero(chosen >= 0)
    columns = chosen[rows].astype(np.int64)
    return rows, columns, distance[rows, columns]


class Partners:
    """Which track of one run each track of the other is: the one that it matched most often of late.

    A single mismatch so changes nothing, and a track that the other run has lost and found again under a new id
    follows within a few frames.
    """

    def __init__(self) -> None:
        self._matches: dict[int, deque[int]] = {}
        self._partner: dict[int, int] = {}
        self._seen: dict[int, int] = {}
        self._frame = 0

    def update(self, ids: NDArray[np.int64], matched: NDArray[np.int64]) -> NDArray[np.int64]:
        """Take a frame's matches.

        Args:
            ids: (K,) matched tracks.
            matched: (K,) what each of them matched in this frame, tracks of the other run.

        Returns:
            (K,) int64 the other run's track that each of them is.
        """
        self._frame += 1
        for track, other in zip(ids.tolist(), matched.tolist(), strict=True):
            past = self._matches.setdefault(track, deque(maxlen=MEMORY))
            past.append(other)
            counts = Counter(past)
            best = max(counts.values())
            if counts[self._partner.get(track, -1)] < best:
                self._partner[track] = next(k for k in counts if counts[k] == best)
            self._seen[track] = self._frame
        self._forget()
        return np.array([self._partner[track] for track in ids.tolist()], np.int64)

    def _forget(self) -> None:
        if self._frame % FORGET_FRAMES == 0:
            for track in [k for k, seen in self._seen.items() if self._frame - seen > FORGET_FRAMES]:
                del self._matches[track], self._partner[track], self._seen[track]


class TrackLengths:
    """In how many frames each track was seen, in memory for the live ones alone."""

    def __init__(self) -> None:
        self._live: dict[int, tuple[int, int]] = {}  # frames seen, last frame seen
        self._over: Counter[int] = Counter()  # tracks by length
        self._frame = 0

    def add(self, ids: NDArray[np.int64]) -> None:
        """Take a frame's tracks."""
        self._frame += 1
        for track in ids.tolist():
            self._live[track] = self._live.get(track, (0, 0))[0] + 1, self._frame
        if self._frame % FORGET_FRAMES == 0:
            for track in [k for k, (_, seen) in self._live.items() if self._frame - seen > FORGET_FRAMES]:
                self._over[self._live.pop(track)[0]] += 1

    def lengths(self) -> NDArray[np.int64]:
        """(T,) int64 frames of every track, ascending."""
        counts = self._over + Counter(length for length, _ in self._live.values())
        return np.repeat(np.array(sorted(counts), np.int64), [counts[k] for k in sorted(counts)])

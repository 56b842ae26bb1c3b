"""Frames with known lines, which true line a detected line is, and what a tracker makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from airline.lines import LineSet
from frontend.frame import Frame
from frontend.tracks import LineTracks

UNKNOWN = -1
AMBIGUOUS = -2
MAX_DISTANCE = 1.25  # px; lines are found within 0.3 px in the median, so what is farther away is another line
MAX_SINE = float(np.sin(np.deg2rad(5.0)))
END_SLACK = 1.0  # px that the ends of a short line may be turned aside, where 5 degrees are less
MIN_COVER = 0.5  # of the detected line
MARGIN = 1.0  # px by which the nearest line must be nearer than a rival
RIVAL_COVER = 0.25  # of the detected line


@dataclass(frozen=True)
class Truth:
    """The lines that can be seen in one frame.

    Attributes:
        segments_px: (N, 2, 2) float32 visible pieces, px.
        ids: (N,) int64 the physical line of each piece, the same over the whole clip; a line may be in pieces.
    """

    segments_px: NDArray[np.float32]
    ids: NDArray[np.int64]


class Clip(Protocol):
    """A short stream with known identities, the same each time, by the name that the table and the JSON give it."""

    @property
    def name(self) -> str: ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[tuple[Frame, Truth]]: ...


@dataclass(frozen=True)
class Tracked:
    """What of `LineTracks` is evaluated. Row k of every array speaks of the same track, whose line was detected.

    Attributes:
        ids: (N,) int64 track ids, no two alike.
        line_indices: (N,) int32 row of the track's detection in the frame's `LineSet`.
        segments_px: (N, 2, 2) float32 where the tracker has the line, px.
        fragment_of: (N,) int64 the track that this one is known to be a piece of, -1 for none.
    """

    ids: NDArray[np.int64]
    line_indices: NDArray[np.int32]
    segments_px: NDArray[np.float32]
    fragment_of: NDArray[np.int64]

    @property
    def observed_px(self) -> NDArray[np.float32]:
        """(N, 2, 2) nothing is fused."""
        return self.segments_px

    @property
    def measured(self) -> NDArray[np.bool_]:
        return np.zeros(len(self.ids), np.bool_)

    stable = measured


class Tracker(Protocol):
    """Takes the lines of one frame after the other, and the edge map that they were found in."""

    def update(
        self, frame: Frame, lines: LineSet, edges: NDArray[np.float32] | None = None
    ) -> Tracked | LineTracks: ...


@dataclass(frozen=True)
class Record:
    """One frame of a tracker's run.

    Attributes:
        tracked: the tracker's answer.
        line_owners: (M,) int64 true line of every detected line, see `owners`.
        truth: what could be seen.
        size: (width, height) of the image, px.
        ms: time of the tracker's update.
    """

    tracked: Tracked | LineTracks
    line_owners: NDArray[np.int64]
    truth: Truth
    size: tuple[int, int]
    ms: float

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """(N,) int64 true line of every track: its detection's, or where it was measured that of what was observed."""
        found = np.append(self.line_owners, UNKNOWN)[self.tracked.line_indices]
        measured = self.tracked.measured
        found[measured] = owners(self.tracked.observed_px[measured], self.truth)
        return found

    @property
    def identities(self) -> NDArray[np.int64]:
        """(N,) int64 the track each row is an observation of: for a fragment the one it is a piece of."""
        return np.where(self.tracked.fragment_of >= 0, self.tracked.fragment_of, self.tracked.ids)

    @cached_property
    def detected(self) -> NDArray[np.int64]:
        """(K,) int64 ids, ascending, of the true lines that were detected."""
        return np.unique(self.line_owners[self.line_owners >= 0])


def owners(detected: NDArray[np.float32], truth: Truth) -> NDArray[np.int64]:
    """The true line that each detected line belongs to.

    A piece of a true line speaks for a detected line if the angle between them is at most 5 degrees, or for lines
    under 23 px what turns their ends aside by 1 px. Its distance is the mean across the detected line, over the part
    that both have in common; that of a true line is the mean of its pieces'. The detected line belongs to the nearest
    true line that is at most 1.25 px away and whose pieces cover half of it. It is ambiguous when another that covers
    a quarter of it is nearer, or less than 1 px farther away. Several may belong to one true line: it broke.

    Args:
        detected: (N, 2, 2) px.
        truth: what can be seen.

    Returns:
        (N,) int64 ids of true lines, -1 where there is none, -2 where it is ambiguous.
    """
    ids, line_of_piece = np.unique(truth.ids, return_inverse=True)
    lines = _owners(detected.astype(np.float64), truth.segments_px.astype(np.float64), line_of_piece, len(ids))
    return np.where(lines >= 0, ids[lines] if len(ids) else UNKNOWN, lines)


def longest_pieces(truth: Truth, ids: NDArray[np.int64]) -> NDArray[np.intp]:
    """(N,) rows of the longest pieces of true lines (N,) that can be seen."""
    delta = truth.segments_px[:, 1] - truth.segments_px[:, 0]
    order = np.lexsort((np.hypot(delta[:, 0], delta[:, 1]), truth.ids))
    return np.asarray(order[np.searchsorted(truth.ids[order], ids, side="right") - 1])


@njit()
def _owners(detected, pieces, line_of_piece, lines):  # type: ignore[no-untyped-def]
    owner = np.full(len(detected), UNKNOWN, np.int64)
    covered, distance = np.empty(lines), np.empty(lines)
    for i in range(len(detected)):
        x0, y0 = detected[i, 0]
        ux, uy = detected[i, 1, 0] - x0, detected[i, 1, 1] - y0
        length = np.hypot(ux, uy)
        if length == 0:
            continue
        ux, uy = ux / length, uy / length
        max_sine = max(MAX_SINE, min(1.0, 2 * END_SLACK / length))
        covered[:], distance[:] = 0, 0
        for j in range(len(pieces)):
            ax, ay = pieces[j, 0, 0] - x0, pieces[j, 0, 1] - y0
            bx, by = pieces[j, 1, 0] - x0, pieces[j, 1, 1] - y0
            ta, tb = ax * ux + ay * uy, bx * ux + by * uy
            da, db = ay * ux - ax * uy, by * ux - bx * uy
            if ta > tb:
                ta, tb, da, db = tb, ta, db, da
            low, high = max(ta, 0.0), min(tb, length)
            if high <= low or abs(db - da) > max_sine * np.hypot(tb - ta, db - da):
                continue
            slope = (db - da) / (tb - ta)
            k = line_of_piece[j]
            covered[k] += high - low
            distance[k] += (high - low) * _mean_distance(da + slope * (low - ta), da + slope * (high - ta))
        nearest = np.inf
        for k in range(lines):
            if covered[k] >= MIN_COVER * length and distance[k] < nearest * covered[k]:
                nearest, owner[i] = distance[k] / covered[k], k
        if nearest > MAX_DISTANCE:
            owner[i] = UNKNOWN
            continue
        for k in range(lines):
            rival = k != owner[i] and covered[k] >= RIVAL_COVER * length
            if rival and distance[k] < (nearest + MARGIN) * covered[k]:
                owner[i] = AMBIGUOUS
                break
    return owner


@njit()
def _mean_distance(first, last):  # type: ignore[no-untyped-def]
    """Mean absolute value of a linear function between two places where it is known."""
    if first * last >= 0:
        return 0.5 * abs(first + last)
    return 0.5 * (first * first + last * last) / (abs(first) + abs(last))

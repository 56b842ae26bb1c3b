"""Lines that broke: which lines are pieces of another track's line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from frontend.tracking.overlap import beside, lines_near

MAX_DISTANCE = 1.0  # px of a piece from the line it broke from
MIN_COS = np.cos(np.deg2rad(8.0))  # of the angle between both
MIN_INSIDE = 0.5  # share of a piece within the extent of the whole line
MAX_TWICE = 0.3  # share of a piece beside the piece that the track goes on with: more is a parallel line


def parents(seen: NDArray[np.float32], whole: NDArray[np.float32]) -> NDArray[np.int64]:
    """The older track whose line each line is a piece of.

    Args:
        seen: (M, 2, 2) float32 px, the lines of this frame: first those of the N tracks that go on, by their age, then
            those of no track yet.
        whole: (N, 2, 2) float32 px, the tracks' fused segments.

    Returns:
        (M,) int64 row of the track, or -1.
    """
    rows: NDArray[np.int64] = _parents(seen, whole)
    return rows


@njit()
def _parents(seen, whole):  # type: ignore[no-untyped-def]
    rows = np.full(len(seen), -1, np.int64)
    half = np.float32(0.5)
    x, y = half * (whole[:, 0, 0] + whole[:, 1, 0]), half * (whole[:, 0, 1] + whole[:, 1, 1])
    lengths = np.hypot(whole[:, 1, 0] - whole[:, 0, 0], whole[:, 1, 1] - whole[:, 0, 1])
    near = np.empty(len(whole), np.int64)
    for m in range(len(seen)):
        piece, nearest = seen[m], MAX_DISTANCE
        length = np.hypot(piece[1, 0] - piece[0, 0], piece[1, 1] - piece[0, 1])
        for c in range(lines_near(piece, length, MAX_DISTANCE, x, y, lengths, np.sqrt(1 - MIN_COS**2), near)):
            n = near[c]
            if n >= m:
                break
            shared, at_low, at_high, cosine = beside(whole[n], piece)
            distance = max(at_low, at_high)
            if shared < MIN_INSIDE * length or abs(cosine) < MIN_COS or distance >= nearest:
                continue
            if beside(seen[n], piece)[0] <= MAX_TWICE * length:
                nearest, rows[m] = distance, n
    return rows


def absorbed(
    pieces: NDArray[np.float32], parent_rows: NDArray[np.int64], seen: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Which missed pieces have become part of their parent's line again.

    Args:
        pieces: (M, 2, 2) float32 px, where the pieces should be.
        parent_rows: (M,) int64 row of each one's parent among the lines, or -1.
        seen: (N, 2, 2) float32 px, the lines that the tracks go on with.

    Returns:
        (M,) mask.
    """
    mask: NDArray[np.bool_] = _absorbed(pieces, parent_rows, seen)
    return mask


@njit()
def _absorbed(pieces, parent_rows, seen):  # type: ignore[no-untyped-def]
    mask = np.zeros(len(pieces), np.bool_)
    for m in range(len(pieces)):
        if parent_rows[m] >= 0:
            length = np.hypot(pieces[m, 1, 0] - pieces[m, 0, 0], pieces[m, 1, 1] - pieces[m, 0, 1])
            shared, at_low, at_high, _ = beside(seen[parent_rows[m]], pieces[m])
            mask[m] = shared >= MIN_INSIDE * length and max(at_low, at_high) < 2 * MAX_DISTANCE
    return mask

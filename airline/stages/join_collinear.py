"""Joining of collinear parts (rows as in `airline.stages.split_regions`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.config import FitConfig
from airline.kernels.compiled import njit
from airline.stages.split_regions import principal

CELL = 32.0  # px, side of the cells in which end points are looked up


def join_collinear(moments: NDArray[np.float64], config: FitConfig) -> NDArray[np.int64]:
    """Join collinear neighbours of (P, 10) float64 parts, longest first; parts that others became one with are changed.

    Returns (P,) int64 the part that each part became one with, itself for most.
    """
    owner = np.arange(len(moments))
    if config.max_gap > 0 and len(moments):
        lengths = np.hypot(moments[:, 8] - moments[:, 6], moments[:, 9] - moments[:, 7])
        min_cos = np.cos(np.deg2rad(config.max_angle))
        _join(moments, np.argsort(-lengths, kind="stable"), owner, config.max_gap, config.max_offset, min_cos)
    return owner


@njit()
def _join(moments, longest_first, owner, max_gap, max_offset, min_cos):  # type: ignore[no-untyped-def]
    ends = moments[:, 6:].copy().reshape(2 * len(moments), 2)
    first, following = _look_up(ends)
    axes = np.empty((len(moments), 4))  # centre and direction of each part
    for i in range(len(moments)):
        axes[i, 0], axes[i, 1], axes[i, 2], axes[i, 3] = principal(moments[i])
    for i in longest_first:
        grown = owner[i] == i
        while grown:
            grown = False
            for side in range(2):
                partner = _partner(moments, axes, owner, ends, first, following, i, side, max_gap, max_offset, min_cos)
                if partner >= 0:
                    owner[partner] = i
                    for k in range(6):
                        moments[i, k] += moments[partner, k]
                    axes[i, 0], axes[i, 1], axes[i, 2], axes[i, 3] = principal(moments[i])
                    _extend(moments, axes, i, partner)
                    grown = True
                    break


@njit(inline="always")
def _look_up(ends):  # type: ignore[no-untyped-def]
    """The ends in each cell as linked lists: each cell's first one, and the one that follows each, -1 for none."""
    rows, columns = 1, 1
    for end in range(len(ends)):
        rows, columns = max(rows, _cell(ends[end, 1]) + 1), max(columns, _cell(ends[end, 0]) + 1)
    first = np.full((rows, columns), -1, np.int64)
    following = np.empty(len(ends), np.int64)
    for end in range(len(ends)):
        row, column = _cell(ends[end, 1]), _cell(ends[end, 0])
        following[end] = first[row, column]
        first[row, column] = end
    return first, following


@njit()
def _cell(place):  # type: ignore[no-untyped-def]
    return int(max(place, 0.0) / CELL)


@njit(inline="always")
def _partner(moments, axes, owner, ends, first, following, i, side, max_gap, max_offset, min_cos):  # type: ignore[no-untyped-def]
    """The nearest collinear part beyond one end of part i, or -1."""
    mx, my, ux, uy = axes[i, 0], axes[i, 1], axes[i, 2], axes[i, 3]
    ex, ey = moments[i, 6 + 2 * side], moments[i, 7 + 2 * side]
    if (ex - mx) * ux + (ey - my) * uy < 0:  # let (ux, uy) point outwards
        ux, uy = -ux, -uy
    rows, columns = first.shape
    best, best_squared = -1, max_gap * max_gap
    for cy in range(_cell(ey - max_gap), min(rows - 1, _cell(ey + max_gap)) + 1):
        for cx in range(_cell(ex - max_gap), min(columns - 1, _cell(ex + max_gap)) + 1):
            end = first[cy, cx]
            while end >= 0:
                j, x, y = end // 2, ends[end, 0], ends[end, 1]
                end = following[end]
                squared = (x - ex) * (x - ex) + (y - ey) * (y - ey)
                if squared >= best_squared or j == i or owner[j] != j or (x - ex) * ux + (y - ey) * uy < -1:
                    continue
                nx, ny, vx, vy = axes[j, 0], axes[j, 1], axes[j, 2], axes[j, 3]
                if abs(ux * vx + uy * vy) < min_cos or (nx - ex) * ux + (ny - ey) * uy < 0:
                    continue
                # its end must lie on our axis, and our end on its axis
                ours, theirs = abs((x - mx) * uy - (y - my) * ux), abs((ex - nx) * vy - (ey - ny) * vx)
                if ours <= max_offset and theirs <= max_offset:
                    best, best_squared = j, squared
    return best


@njit(inline="always")
def _extend(moments, axes, i, j):  # type: ignore[no-untyped-def]
    """Set the end points of part i to the outermost projections of both parts' end points on the joint line."""
    mx, my, ux, uy = axes[i, 0], axes[i, 1], axes[i, 2], axes[i, 3]
    low, high = 1e30, -1e30
    for part in (i, j):
        for end in range(2):
            t = (moments[part, 6 + 2 * end] - mx) * ux + (moments[part, 7 + 2 * end] - my) * uy
            low, high = min(low, t), max(high, t)
    moments[i, 6], moments[i, 7] = mx + low * ux, my + low * uy
    moments[i, 8], moments[i, 9] = mx + high * ux, my + high * uy

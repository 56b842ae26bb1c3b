"""The plain partner of a line in the right image: the nearest one on its rows that looks alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit

RANGE = 0.25  # of the image's width: the largest disparity
END_ERROR = 0.3  # px, taken for end points
SLACK, MIN_COMMON, MIN_COSINE, MAX_LEVELS = 1.0, 0.5, float(np.cos(np.deg2rad(10.0))), 20.0

Array = NDArray[np.float64]
Lines = NDArray[np.float32]


def nearest_on_rows(
    left: Lines, right: Lines, left_gray: NDArray[np.uint8], right_gray: NDArray[np.uint8]
) -> NDArray[np.intp]:
    """The partner of each left line (N, 2, 2) among right lines (M, 2, 2), px: row, -1 for none.

    Of the lines with half of the shorter one's rows in common, at most 10 degrees between them, and grey levels on
    both sides that differ by at most 20, the one with the least disparity from 0 to a quarter of the image's width;
    one to one, least disparities first.
    """
    ours, theirs = (np.where(a[:, :1, 1:] > a[:, 1:, 1:], a[:, ::-1], a).astype(np.float64) for a in (left, right))
    levels = _levels(ours, left_gray), _levels(theirs, right_gray)
    return np.asarray(_nearest(ours, theirs, *levels, RANGE * left_gray.shape[1]))


@njit()
def _nearest(ours, theirs, levels, other_levels, most):  # type: ignore[no-untyped-def]
    shifts = np.full((len(ours), len(theirs)), np.inf)  # in the middle of the rows that both have
    for i in range(len(ours)):
        ux, uy = ours[i, 1] - ours[i, 0]
        for j in range(len(theirs)):
            vx, vy = theirs[j, 1] - theirs[j, 0]
            top, bottom = max(ours[i, 0, 1], theirs[j, 0, 1]), min(ours[i, 1, 1], theirs[j, 1, 1])
            if bottom - top + 2 * SLACK < MIN_COMMON * (min(uy, vy) + 2 * SLACK):
                continue
            if abs(ux * vx + uy * vy) < MIN_COSINE * np.hypot(ux, uy) * np.hypot(vx, vy):
                continue
            if np.abs(levels[i] - other_levels[j]).max() > MAX_LEVELS:
                continue
            shift = _in_row(ours[i], (top + bottom) / 2) - _in_row(theirs[j], (top + bottom) / 2)
            if 0 <= shift <= most:
                shifts[i, j] = shift
    partner, free = np.full(len(ours), -1), np.ones(len(theirs), np.bool_)
    for k in np.argsort(shifts.ravel()):
        i, j = divmod(k, len(theirs))
        if shifts[i, j] == np.inf:
            break
        if partner[i] < 0 and free[j]:
            partner[i], free[j] = j, False
    return partner


@njit()
def _in_row(line, y):  # type: ignore[no-untyped-def]
    """X of a line in a row, or of its nearer end."""
    along = (y - line[0, 1]) / max(line[1, 1] - line[0, 1], 1e-9)
    return line[0, 0] + min(max(along, 0.0), 1.0) * (line[1, 0] - line[0, 0])


def _levels(lines: Array, gray: NDArray[np.uint8]) -> Array:
    """(N, 2) mean grey levels 3 px aside of lines."""
    delta = lines[:, 1] - lines[:, 0]
    across = delta[:, ::-1] * (-1, 1) / np.maximum(np.hypot(*delta.T), 1e-9)[:, None]
    steps = lines.mean(axis=1) + np.linspace(-0.4, 0.4, 9)[:, None, None] * delta
    points = steps + 3.0 * np.array([-1, 1])[:, None, None, None] * across
    x, y = np.clip(np.rint(points), 0, np.array(gray.shape)[::-1] - 1).astype(np.intp).transpose(3, 0, 1, 2)
    return np.asarray(gray[y, x].mean(axis=1).T)


def end_errors(lines: Lines) -> Lines:
    """(N, 2, 2) covariances of offset and angle of lines with independent errors of their ends."""
    covariances = np.zeros((len(lines), 2, 2), np.float32)
    covariances[:, 0, 0] = END_ERROR**2 / 2
    covariances[:, 1, 1] = 2 * END_ERROR**2 / np.maximum(((lines[:, 1] - lines[:, 0]) ** 2).sum(axis=1), 1)
    return covariances

"""The plain partner of a line in the right image: the nearest one on its rows that looks alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    levels = _levels(ours, left_gray)[:, None], _levels(theirs, right_gray)
    ours = ours[:, None]
    (ux, uy), (vx, vy) = ((a[..., 1, :] - a[..., 0, :]).transpose(2, 0, 1) for a in (ours, theirs[None]))
    top, bottom = np.maximum(ours[..., 0, 1], theirs[:, 0, 1]), np.minimum(ours[..., 1, 1], theirs[:, 1, 1])
    shifts = _in_rows(ours, (top + bottom) / 2) - _in_rows(theirs, (top + bottom) / 2)
    alike = bottom - top + 2 * SLACK >= MIN_COMMON * (np.minimum(uy, vy) + 2 * SLACK)
    alike &= np.abs(ux * vx + uy * vy) >= MIN_COSINE * np.hypot(ux, uy) * np.hypot(vx, vy)
    alike &= np.abs(levels[0] - levels[1]).max(axis=2) <= MAX_LEVELS
    alike &= (shifts >= 0) & (shifts <= RANGE * left_gray.shape[1])
    partner, free = np.full(len(left), -1), np.ones(len(right), np.bool_)
    rows, columns = np.nonzero(alike)
    for k in np.argsort(shifts[alike]):
        if partner[rows[k]] < 0 and free[columns[k]]:
            partner[rows[k]], free[columns[k]] = columns[k], False
    return partner


def _in_rows(lines: Array, y: Array) -> Array:
    """X of lines in rows, or of their nearer ends."""
    along = (y - lines[..., 0, 1]) / np.maximum(lines[..., 1, 1] - lines[..., 0, 1], 1e-9)
    return np.asarray(lines[..., 0, 0] + np.clip(along, 0, 1) * (lines[..., 1, 0] - lines[..., 0, 0]))


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

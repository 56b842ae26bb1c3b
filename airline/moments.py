"""Total least squares on accumulated moments: fit regions, cut the bent ones.

A part is a row of ten numbers: the weighted moments (sw, sx, sy, sxx, sxy, syy) of its pixels, which add up when parts
are joined, and its end points (x0, y0, x1, y1).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def principal(moments):  # type: ignore[no-untyped-def]
    """Centre and direction of the weighted total-least-squares line of (sw, sx, sy, sxx, sxy, syy)."""
    weight = moments[0]
    mx, my = moments[1] / weight, moments[2] / weight
    xx, xy, yy = moments[3] / weight - mx * mx, moments[4] / weight - mx * my, moments[5] / weight - my * my
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return mx, my, np.cos(angle), np.sin(angle)


def residuals(moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) weighted rms distance of the pixels from their line, px, of (N, 10) parts: the moments' lesser axis."""
    weight, x, y, xx, xy, yy = moments[:, :6].T
    mx, my = x / weight, y / weight
    xx, xy, yy = xx / weight - mx * mx, xy / weight - mx * my, yy / weight - my * my
    variance = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@njit(cache=True, nogil=True)
def fit_regions(positions, weights, order, offsets, max_deviation):  # type: ignore[no-untyped-def]
    """Fit every region, cutting the bent ones.

    Returns the part of each pixel (-1: none) and, per part, (sw, sx, sy, sxx, sxy, syy, x0, y0, x1, y1).
    """
    labels = np.full(len(positions), -1, np.int32)
    moments = np.empty((len(order) + 1, 10))
    count = 0
    along = np.empty(len(order))
    stack = np.empty((64, 2), np.int64)
    for region in range(len(offsets) - 1):
        rows = order[offsets[region] : offsets[region + 1]].copy()
        stack[0] = 0, len(rows)
        depth = 1
        while depth > 0:
            depth -= 1
            start, end = stack[depth]
            part = moments[count]
            part[:] = 0
            for k in range(start, end):
                x, y = np.float64(positions[rows[k], 0]), np.float64(positions[rows[k], 1])
                w = np.float64(weights[rows[k]]) + 1e-12
                part[0] += w
                part[1] += w * x
                part[2] += w * y
                part[3] += w * x * x
                part[4] += w * x * y
                part[5] += w * y * y
            mx, my, ux, uy = principal(part)
            for k in range(start, end):
                along[k - start] = (positions[rows[k], 0] - mx) * ux + (positions[rows[k], 1] - my) * uy
            span = along[: end - start]
            t0, t1 = span.min(), span.max()
            cut = -1
            if end - start >= 12 and depth < 62:
                sorting = np.argsort(span, kind="mergesort")
                rows[start:end] = rows[start:end][sorting]
                cut = _farthest(positions, rows, start, end, max_deviation)
            if cut >= 0:
                stack[depth] = start, cut
                stack[depth + 1] = cut, end
                depth += 2
                continue
            for k in range(start, end):
                labels[rows[k]] = count
            part[6], part[7], part[8], part[9] = mx + t0 * ux, my + t0 * uy, mx + t1 * ux, my + t1 * uy
            count += 1
    return labels, moments[:count].copy()


@njit(cache=True, nogil=True)
def _farthest(positions, rows, start, end, max_deviation):  # type: ignore[no-untyped-def]
    """Where to cut pixels sorted along their line: the farthest from the chord if beyond `max_deviation`, else -1."""
    x0, y0 = positions[rows[start], 0], positions[rows[start], 1]
    dx, dy = positions[rows[end - 1], 0] - x0, positions[rows[end - 1], 1] - y0
    length = np.hypot(dx, dy)
    worst, cut = max_deviation, -1
    for k in range(start + 4, end - 4):
        deviation = abs((positions[rows[k], 0] - x0) * dy - (positions[rows[k], 1] - y0) * dx) / max(length, 1e-6)
        if deviation > worst:
            worst, cut = deviation, k
    return cut

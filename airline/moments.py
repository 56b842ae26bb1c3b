"""Total least squares on accumulated moments: fit regions, cut the bent ones.

A part is a row of ten numbers: the weighted moments (sw, sx, sy, sxx, sxy, syy) of its pixels, which add up when parts
are joined, and its end points (x0, y0, x1, y1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.compiled import njit

MARGIN = 4  # pixels at each end of a region at which it is not cut


@njit(cache=True, nogil=True)
def principal(moments):  # type: ignore[no-untyped-def]
    """Centre and direction of the weighted total-least-squares line of (sw, sx, sy, sxx, sxy, syy)."""
    weight = moments[0]
    mx, my = moments[1] / weight, moments[2] / weight
    xx, xy, yy = moments[3] / weight - mx * mx, moments[4] / weight - mx * my, moments[5] / weight - my * my
    # cosine and sine of half of the angle whose tangent is 2 xy / (xx - yy)
    root = np.hypot(xx - yy, 2 * xy)
    if root < 1e-30:
        return mx, my, 1.0, 0.0
    if xx >= yy:
        cos = np.sqrt(0.5 + 0.5 * (xx - yy) / root)
        return mx, my, cos, xy / (root * cos)
    sin = np.sqrt(0.5 - 0.5 * (xx - yy) / root)
    return mx, my, abs(xy) / (root * sin), np.copysign(sin, xy)


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
    starts, ends = np.empty(64, np.int64), np.empty(64, np.int64)  # of what is left of a region
    rows = order.copy()
    for region in range(len(offsets) - 1):
        starts[0], ends[0] = offsets[region], offsets[region + 1]
        depth = 1
        while depth > 0:
            depth -= 1
            start, end = starts[depth], ends[depth]
            part = moments[count]
            _sum_moments(positions, weights, rows, start, end, part)
            mx, my, ux, uy = principal(part)
            first, last = start, start  # the outermost pixels
            for k in range(start, end):
                along[k] = (positions[rows[k], 0] - mx) * ux + (positions[rows[k], 1] - my) * uy
                first = k if along[k] < along[first] else first
                last = k if along[k] > along[last] else last
            t0, t1 = along[first], along[last]
            if end - start >= 12 and depth < 62:
                bend = _bend(positions, rows, along, start, end, first, last, max_deviation)
                if bend >= 0:
                    cut = _divide(rows, along, start, end, along[bend])
                    starts[depth], ends[depth] = start, cut
                    starts[depth + 1], ends[depth + 1] = cut, end
                    depth += 2
                    continue
            for k in range(start, end):
                labels[rows[k]] = count
            part[6], part[7], part[8], part[9] = mx + t0 * ux, my + t0 * uy, mx + t1 * ux, my + t1 * uy
            count += 1
    return labels, moments[:count].copy()


@njit(cache=True, nogil=True)
def _sum_moments(positions, weights, rows, start, end, part):  # type: ignore[no-untyped-def]
    """Set the first six numbers of a part."""
    sw, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(start, end):
        row = rows[k]
        x, y = np.float64(positions[row, 0]), np.float64(positions[row, 1])
        w = np.float64(weights[row]) + 1e-12
        sw += w
        sx += w * x
        sy += w * y
        sxx += w * x * x
        sxy += w * x * y
        syy += w * y * y
    part[0], part[1], part[2], part[3], part[4], part[5] = sw, sx, sy, sxx, sxy, syy


@njit(cache=True, nogil=True, error_model="numpy")
def _bend(positions, rows, along, start, end, first, last, max_deviation):  # type: ignore[no-untyped-def]
    """The pixel farthest from the chord of the outermost two, if beyond `max_deviation`, else -1; `MARGIN` at each end
    are left out.
    """
    x0, y0 = positions[rows[first], 0], positions[rows[first], 1]
    dx, dy = positions[rows[last], 0] - x0, positions[rows[last], 1] - y0
    worst, bend = max_deviation * max(np.hypot(dx, dy), 1e-6), -1
    low, high = -np.inf, np.inf
    for k in range(start, end):
        deviation = abs((positions[rows[k], 0] - x0) * dy - (positions[rows[k], 1] - y0) * dx)
        if deviation > worst:
            if low == -np.inf:  # few regions bend
                low, high = _beyond_margins(along, start, end)
            if low < along[k] < high:
                worst, bend = deviation, k
    return bend


@njit(cache=True, nogil=True)
def _beyond_margins(along, start, end):  # type: ignore[no-untyped-def]
    """The least and the greatest place but for `MARGIN - 1` at each end."""
    low, high = np.full(MARGIN, np.inf), np.full(MARGIN, -np.inf)  # sorted, the middle of the line last
    for k in range(start, end):
        least, greatest = along[k], along[k]
        for i in range(MARGIN):
            if least < low[i]:
                least, low[i] = low[i], least
            if greatest > high[i]:
                greatest, high[i] = high[i], greatest
    return low[MARGIN - 1], high[MARGIN - 1]


@njit(cache=True, nogil=True)
def _divide(rows, along, start, end, place):  # type: ignore[no-untyped-def]
    """Put the pixels before a place along a region's line first; returns where the others begin."""
    kept = start
    for k in range(start, end):
        if along[k] < place:
            rows[k], rows[kept] = rows[kept], rows[k]
            along[k], along[kept] = along[kept], along[k]
            kept += 1
    return kept

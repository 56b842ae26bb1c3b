"""Parts of regions: fitted by total least squares on accumulated moments, cut where they bend, joined where collinear.

A part is a row of ten numbers: the weighted moments (sw, sx, sy, sxx, sxy, syy) of its pixels, which add up when parts
are joined, and its end points (x0, y0, x1, y1).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.config import FitConfig
from airline.kernels.compiled import njit
from airline.kernels.threads import ALONE, ThreadTeam

CELL = 32.0  # px, side of the cells in which end points are looked up
MARGIN = 4  # pixels at each end of a region at which it is not cut
# (K,) rows of pixels, those of a part together; (P, 2) where each part begins and ends among them; (P, 10) the parts
Parts = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]
WAITING = 63  # parts of a region that are not fitted yet, at most; see `split_regions`


@njit()
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


@njit()
def residual(part):  # type: ignore[no-untyped-def]
    """Weighted rms distance of a part's pixels from their line, px: the moments' lesser axis."""
    weight = part[0]
    mx, my = part[1] / weight, part[2] / weight
    xx, xy, yy = part[3] / weight - mx * mx, part[4] / weight - mx * my, part[5] / weight - my * my
    return np.sqrt(max(0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy), 0.0))


def split_regions(
    positions: NDArray[np.float32],
    weights: NDArray[np.float32],
    order: NDArray[np.int64],
    offsets: NDArray[np.int64],
    max_deviation: float,
    team: ThreadTeam = ALONE,
) -> Parts:
    """Fit every region, cutting the bent ones.

    Of two parts the later one along the line is cut and fitted first, while the other waits. Where as many wait as may,
    the region is texture that would crumble into a swarm of short straight lines: no more cuts are made there.

    Args:
        positions, weights: (M, 2), px, and (M,) of all pixels.
        order, offsets: the pixels of each region, see `airline.stages.fit.group`.
        max_deviation: px, see `FitConfig`.
        team: threads that share the work.
    """
    rows, begins = order[offsets[0] :].copy(), offsets - offsets[0]

    def split(start: int, end: int) -> Any:
        return _split_regions(positions, weights, rows, begins[start : end + 1], max_deviation)

    bounds, moments = zip(*team.map_range(len(begins) - 1, 64, split), strict=True)
    return rows, np.concatenate(bounds), np.concatenate(moments)


@njit()
def _split_regions(positions, weights, rows, begins, max_deviation):  # type: ignore[no-untyped-def]
    """Where the parts of some regions begin and end, and their numbers; puts the rows of a part together."""
    most = begins[-1] - begins[0]
    bounds = np.empty((most, 2), np.int64)
    moments = np.empty((most, 10), np.float64)
    count = 0
    points = np.empty((4, most), np.float64)  # of the region at hand: x, y, weight, place along its line
    starts, ends = np.empty(WAITING + 1, np.int64), np.empty(WAITING + 1, np.int64)  # of what is left of a region
    for region in range(len(begins) - 1):
        starts[0], ends[0] = begins[region], begins[region + 1]
        depth = 1
        while depth > 0:
            depth -= 1
            start, end = starts[depth], ends[depth]
            size = end - start
            part = moments[count]
            _take(positions, weights, rows, start, size, points)
            _sum_moments(points, size, part)
            mx, my, ux, uy = principal(part)
            t0, t1 = _project(points, size, mx, my, ux, uy)
            if size >= 12 and depth < WAITING - 1:
                bend = _bend(points, size, t0, t1, max_deviation)
                if bend >= 0:
                    cut = start + _divide(rows, start, points[3], size, points[3, bend])
                    starts[depth], ends[depth] = start, cut
                    starts[depth + 1], ends[depth + 1] = cut, end
                    depth += 2
                    continue
            part[6], part[7], part[8], part[9] = mx + t0 * ux, my + t0 * uy, mx + t1 * ux, my + t1 * uy
            bounds[count, 0], bounds[count, 1] = start, end
            count += 1
    return bounds[:count].copy(), moments[:count].copy()


@njit(inline="always")
def _take(positions, weights, rows, start, size, points):  # type: ignore[no-untyped-def]
    """Bring the pixels of a part together."""
    for k in range(size):
        place, row = np.uint64(k), np.uint64(rows[np.uint64(start + k)])
        points[0, place] = positions[row, 0]
        points[1, place] = positions[row, 1]
        points[2, place] = weights[row] + 1e-12


@njit(fastmath={"reassoc", "contract", "nsz"})
def _sum_moments(points, size, part):  # type: ignore[no-untyped-def]
    """Set the first six numbers of a part."""
    sw, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(size):
        x, y, w = points[0, k], points[1, k], points[2, k]
        sw += w
        sx += w * x
        sy += w * y
        sxx += w * x * x
        sxy += w * x * y
        syy += w * y * y
    part[0], part[1], part[2], part[3], part[4], part[5] = sw, sx, sy, sxx, sxy, syy


@njit(fastmath={"nnan", "nsz", "contract"})
def _project(points, size, mx, my, ux, uy):  # type: ignore[no-untyped-def]
    """Set the places along the line; returns the least and the greatest."""
    low, high = np.inf, -np.inf
    for k in range(size):
        along = (points[0, k] - mx) * ux + (points[1, k] - my) * uy
        points[3, k] = along
        low, high = min(low, along), max(high, along)
    return low, high


@njit(inline="always")
def _bend(points, size, t0, t1, max_deviation):  # type: ignore[no-untyped-def]
    """The pixel farthest from the chord of the outermost two, `MARGIN` at each end left out; -1 where it bends less."""
    x, y, along = points[0], points[1], points[3]
    first, last = 0, 0
    for k in range(size - 1, -1, -1):
        first = k if along[k] == t0 else first
        last = k if along[k] == t1 else last
    x0, y0 = x[first], y[first]
    dx, dy = x[last] - x0, y[last] - y0
    worst, bend = max_deviation * max(np.hypot(dx, dy), 1e-6), -1
    if _farthest(points, size, x0, y0, dx, dy) <= worst:
        return bend
    low, high = _beyond_margins(along, size)
    for k in range(size):
        deviation = abs((x[k] - x0) * dy - (y[k] - y0) * dx)
        if deviation > worst and low < along[k] < high:
            worst, bend = deviation, k
    return bend


@njit(fastmath={"nnan", "nsz", "contract"})
def _farthest(points, size, x0, y0, dx, dy):  # type: ignore[no-untyped-def]
    """Greatest distance from a chord, times the chord's length."""
    worst = 0.0
    for k in range(size):
        worst = max(worst, abs((points[0, k] - x0) * dy - (points[1, k] - y0) * dx))
    return worst


@njit(inline="always")
def _beyond_margins(along, size):  # type: ignore[no-untyped-def]
    """The least and the greatest place but for `MARGIN - 1` at each end."""
    low, high = np.full(MARGIN, np.inf), np.full(MARGIN, -np.inf)  # sorted, the middle of the line last
    for k in range(size):
        least, greatest = along[k], along[k]
        for i in range(MARGIN):
            if least < low[i]:
                least, low[i] = low[i], least
            if greatest > high[i]:
                greatest, high[i] = high[i], greatest
    return low[MARGIN - 1], high[MARGIN - 1]


@njit(inline="always")
def _divide(rows, start, along, size, place):  # type: ignore[no-untyped-def]
    """Put the rows of the pixels before a place along a region's line first; returns how many there are."""
    kept = 0
    for k in range(size):
        if along[k] < place:
            rows[start + k], rows[start + kept] = rows[start + kept], rows[start + k]
            along[k], along[kept] = along[kept], along[k]
            kept += 1
    return kept


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

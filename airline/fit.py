"""Stage 4: line parameters of a region, by voting of its pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.lines import LineSet
from airline.pixels import EdgePixels


class LineFitter(Protocol):
    """Turns regions of edge pixels into segments."""

    def fit(
        self, edge: EdgePixels, descriptors: NDArray[np.float32], regions: NDArray[np.int32]
    ) -> tuple[LineSet, NDArray[np.int32]]:
        """Segments of the regions.

        Args:
            edge: M edge pixels.
            descriptors: (M, C) float32 unit rows.
            regions: (M,) int32 region of each pixel, -1 for none.

        Returns:
            The N lines, and (M,) int32 the line of each pixel, -1 for none.
        """
        ...


@dataclass(frozen=True)
class TotalLeastSquaresFitter:
    """Weighted total least squares over sub-pixel ridge positions; weights are edge probabilities.

    A region that bends more than `max_deviation` is cut at its farthest pixel from the chord and each part is fitted
    alone (Ramer 1972, Douglas and Peucker 1973). Neighbouring collinear lines are then joined: pixel moments add up,
    so a joint fit costs nothing. End points start at the projections of the outermost pixels and move on along the
    line while the edge map stays above half the line's mean strength: pixels near corners mix two orientations and
    belong to no region, yet the line runs on to the corner.

    Attributes:
        min_length: shorter lines are dropped, px.
        max_deviation: a region may leave its chord by this much, px.
        max_gap: collinear lines that end within this distance of each other are joined, px; 0 joins none.
        max_offset: joined lines may miss each other's axis by this much at the gap, px.
        max_angle: and differ in direction by this much, degrees.
        max_reach: end points move on along the edge by at most this much, px.
    """

    min_length: float = 10.0
    max_deviation: float = 1.5
    max_gap: float = 4.0
    max_offset: float = 1.0
    max_angle: float = 5.0
    max_reach: float = 8.0

    def __post_init__(self) -> None:
        if min(self.min_length, self.max_gap, self.max_offset, self.max_angle, self.max_reach) < 0 or self.max_deviation <= 0:
            raise ConfigError("fit lengths and angles must not be negative and max_deviation must be positive")

    def fit(
        self, edge: EdgePixels, descriptors: NDArray[np.float32], regions: NDArray[np.int32]
    ) -> tuple[LineSet, NDArray[np.int32]]:
        """See `LineFitter.fit`."""
        order, offsets = group(regions)
        parts, moments = _fit_regions(edge.positions, edge.weights, order, offsets, self.max_deviation)
        merged = _join(moments, self.max_gap, self.max_offset, np.cos(np.deg2rad(self.max_angle)))
        _reach(moments, merged, edge.support, self.max_reach)
        segments, lines_of = _segments(moments, merged, self.min_length)
        # rows no part covers point at the last element, which is -1
        labels = np.append(lines_of, np.int32(-1))[parts]
        return _line_set(segments, labels, edge.weights, descriptors), labels


@dataclass(frozen=True)
class PaperFitter:
    """The paper's voting (equation 5), with each vector turned to agree with the running sum.

    As printed, the tangent `sum(x - m)` is zero; so, as in the released code, the sign of each vector is flipped
    where it opposes the sum so far. The end points are the projection of the farthest pixel, to both sides.
    """

    def fit(
        self, edge: EdgePixels, descriptors: NDArray[np.float32], regions: NDArray[np.int32]
    ) -> tuple[LineSet, NDArray[np.int32]]:
        """See `LineFitter.fit`."""
        order, offsets = group(regions)
        segments = _paper_fit(edge.positions, order, offsets)
        return _line_set(segments, regions, edge.weights, descriptors), regions


def group(labels: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows sorted by label, and where each label's rows begin: label k owns `order[offsets[k]:offsets[k + 1]]`."""
    order = np.argsort(labels, kind="stable")
    last = int(labels.max(initial=-1))
    return order, np.searchsorted(labels[order], np.arange(last + 2))


def _line_set(
    segments: NDArray[np.float32],
    labels: NDArray[np.int32],
    weights: NDArray[np.float32],
    descriptors: NDArray[np.float32],
) -> LineSet:
    """Scores (mean edge strength times the share of the length that has pixels) and mean descriptors."""
    count, channels = len(segments), descriptors.shape[1]
    score = np.zeros(count, np.float32)
    mean = np.zeros((count, channels), np.float32)
    _accumulate(labels, weights, descriptors, score, mean)
    extent = np.abs(segments[:, 1] - segments[:, 0]).max(axis=1, initial=0) + 1
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    return LineSet(segments, np.minimum(1, score / extent), mean)


@njit(cache=True, nogil=True)
def _accumulate(labels, weights, descriptors, score, mean):  # type: ignore[no-untyped-def]
    for k in range(len(labels)):
        if labels[k] >= 0:
            score[labels[k]] += weights[k]
            for c in range(descriptors.shape[1]):
                mean[labels[k], c] += descriptors[k, c]


@njit(cache=True, nogil=True)
def _principal(moments):  # type: ignore[no-untyped-def]
    """Centre and direction of the weighted total-least-squares line of (sw, sx, sy, sxx, sxy, syy)."""
    weight = moments[0]
    mx, my = moments[1] / weight, moments[2] / weight
    xx, xy, yy = moments[3] / weight - mx * mx, moments[4] / weight - mx * my, moments[5] / weight - my * my
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return mx, my, np.cos(angle), np.sin(angle)


@njit(cache=True, nogil=True)
def _fit_regions(positions, weights, order, offsets, max_deviation):  # type: ignore[no-untyped-def]
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
            mx, my, ux, uy = _principal(part)
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


CELL = 32.0  # px, side of the cells in which end points are looked up


@njit(cache=True, nogil=True)
def _join(moments, max_gap, max_offset, min_cos):  # type: ignore[no-untyped-def]
    """Join collinear neighbours, longest first; returns for each part the part that it became one with."""
    count = len(moments)
    owner = np.arange(count)
    if max_gap <= 0 or count == 0:
        return owner
    ends = moments[:, 6:].copy().reshape(2 * count, 2)
    cells = np.maximum(ends / CELL, 0).astype(np.int64)
    columns, rows = cells[:, 0].max() + 1, cells[:, 1].max() + 1
    # the ends in each cell as a linked list
    first = np.full((rows, columns), -1, np.int64)
    following = np.empty(2 * count, np.int64)
    for end in range(2 * count):
        following[end] = first[cells[end, 1], cells[end, 0]]
        first[cells[end, 1], cells[end, 0]] = end
    lengths = np.hypot(ends[1::2, 0] - ends[::2, 0], ends[1::2, 1] - ends[::2, 1])
    for i in np.argsort(-lengths, kind="mergesort"):
        grown = owner[i] == i
        while grown:
            grown = False
            for side in range(2):
                partner = _partner(moments, owner, ends, first, following, i, side, max_gap, max_offset, min_cos)
                if partner >= 0:
                    owner[partner] = i
                    moments[i, :6] += moments[partner, :6]
                    _extend(moments, i, partner)
                    grown = True
                    break
    return owner


@njit(cache=True, nogil=True)
def _partner(moments, owner, ends, first, following, i, side, max_gap, max_offset, min_cos):  # type: ignore[no-untyped-def]
    """The nearest collinear part beyond one end of part i, or -1."""
    mx, my, ux, uy = _principal(moments[i])
    ex, ey = moments[i, 6 + 2 * side], moments[i, 7 + 2 * side]
    if (ex - mx) * ux + (ey - my) * uy < 0:  # let (ux, uy) point outwards
        ux, uy = -ux, -uy
    rows, columns = first.shape
    best, best_gap = -1, max_gap
    for cy in range(int(max(ey - max_gap, 0) / CELL), min(rows - 1, int(max(ey + max_gap, 0) / CELL)) + 1):
        for cx in range(int(max(ex - max_gap, 0) / CELL), min(columns - 1, int(max(ex + max_gap, 0) / CELL)) + 1):
            end = first[cy, cx]
            while end >= 0:
                j, x, y = end // 2, ends[end, 0], ends[end, 1]
                end = following[end]
                gap = np.hypot(x - ex, y - ey)
                if gap >= best_gap or j == i or owner[j] != j or (x - ex) * ux + (y - ey) * uy < -1:
                    continue
                nx, ny, vx, vy = _principal(moments[j])
                if abs(ux * vx + uy * vy) < min_cos or (nx - ex) * ux + (ny - ey) * uy < 0:
                    continue
                # its end must lie on our axis, and our end on its axis
                ours, theirs = abs((x - mx) * uy - (y - my) * ux), abs((ex - nx) * vy - (ey - ny) * vx)
                if ours <= max_offset and theirs <= max_offset:
                    best, best_gap = j, gap
    return best


@njit(cache=True, nogil=True)
def _extend(moments, i, j):  # type: ignore[no-untyped-def]
    """Set the end points of part i to the outermost projections of both parts' end points on the joint line."""
    mx, my, ux, uy = _principal(moments[i])
    low, high = 1e30, -1e30
    for part in (i, j):
        for end in range(2):
            t = (moments[part, 6 + 2 * end] - mx) * ux + (moments[part, 7 + 2 * end] - my) * uy
            low, high = min(low, t), max(high, t)
    moments[i, 6], moments[i, 7] = mx + low * ux, my + low * uy
    moments[i, 8], moments[i, 9] = mx + high * ux, my + high * uy


FALL = 1.0  # px beyond its end where a smoothed ridge has fallen to half its height
STEP = 0.5  # px


@njit(cache=True, nogil=True)
def _reach(moments, owner, support, max_reach):  # type: ignore[no-untyped-def]
    """Move the end points of the surviving parts to where the edge map falls to half the line's mean."""
    height, width = support.shape
    for i in range(len(moments)):
        dx, dy = moments[i, 8] - moments[i, 6], moments[i, 9] - moments[i, 7]
        length = np.hypot(dx, dy)
        if owner[i] != i or max_reach <= 0 or length < 4:
            continue
        dx, dy = dx / length, dy / length
        samples = int(length)
        level = 0.0
        for k in range(samples):
            t = length * k / (samples - 1)
            level += 0.5 * _bilinear(support, moments[i, 6] + t * dx, moments[i, 7] + t * dy) / samples
        for side in range(2):
            x, y = moments[i, 6 + 2 * side], moments[i, 7 + 2 * side]
            ux, uy = (dx, dy) if side else (-dx, -dy)
            t = -1.5
            while t < max_reach + FALL and _bilinear(support, x + (t + STEP) * ux, y + (t + STEP) * uy) > level:
                t += STEP
            t -= FALL
            moments[i, 6 + 2 * side] = min(max(x + t * ux, -0.5), width - 0.5)
            moments[i, 7 + 2 * side] = min(max(y + t * uy, -0.5), height - 0.5)


@njit(cache=True, nogil=True)
def _bilinear(image, x, y):  # type: ignore[no-untyped-def]
    """Value between pixels; 0 more than half a pixel outside the image."""
    height, width = image.shape
    if x < -0.5 or y < -0.5 or x > width - 0.5 or y > height - 0.5:
        return 0.0
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    column, row = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    fx, fy = x - column, y - row
    right, below = min(column + 1, width - 1), min(row + 1, height - 1)
    top = (1 - fx) * image[row, column] + fx * image[row, right]
    return (1 - fy) * top + fy * ((1 - fx) * image[below, column] + fx * image[below, right])


@njit(cache=True, nogil=True)
def _segments(moments, owner, min_length):  # type: ignore[no-untyped-def]
    """Segments of the surviving parts that are long enough, and the line number of each part (-1: none)."""
    count = len(moments)
    numbers = np.full(count, -1, np.int32)
    segments = np.empty((count, 2, 2), np.float32)
    lines = 0
    for i in range(count):
        length = np.hypot(moments[i, 8] - moments[i, 6], moments[i, 9] - moments[i, 7])
        if owner[i] == i and length >= min_length:
            numbers[i] = lines
            segments[lines, 0] = moments[i, 6:8]
            segments[lines, 1] = moments[i, 8:10]
            lines += 1
    for i in range(count):
        root = i
        while owner[root] != root:
            root = owner[root]
        numbers[i] = numbers[root]
    return segments[:lines].copy(), numbers


@njit(cache=True, nogil=True)
def _paper_fit(positions, order, offsets):  # type: ignore[no-untyped-def]
    segments = np.empty((len(offsets) - 1, 2, 2), np.float32)
    for region in range(len(offsets) - 1):
        rows = order[offsets[region] : offsets[region + 1]]
        mx, my = 0.0, 0.0
        for row in rows:
            mx += positions[row, 0]
            my += positions[row, 1]
        mx, my = mx / len(rows), my / len(rows)
        vx, vy, fx, fy, farthest = 0.0, 0.0, 0.0, 0.0, -1.0
        for row in rows:
            x, y = positions[row, 0] - mx, positions[row, 1] - my
            sign = 1.0 if x * vx + y * vy >= 0 else -1.0
            vx += sign * x
            vy += sign * y
            if x * x + y * y > farthest:
                farthest, fx, fy = x * x + y * y, x, y
        norm = max(np.hypot(vx, vy), 1e-12)
        vx, vy = vx / norm, vy / norm
        reach = abs(vx * fx + vy * fy)
        segments[region, 0] = mx - reach * vx, my - reach * vy
        segments[region, 1] = mx + reach * vx, my + reach * vy
    return segments

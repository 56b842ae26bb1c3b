"""Stage 4: line parameters of a region, by voting of its pixels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airline.config import FitConfig
from airline.kernels.compiled import njit
from airline.kernels.threads import ALONE, ThreadTeam
from airline.lines import LineSet
from airline.stages.parts import Parts, join_collinear, residual, split_regions
from airline.stages.pixels import EdgePixels
from airline.stages.score_parts import extend_ends, line_scores, score_parts

Fitted = tuple[LineSet, NDArray[np.int32]]  # lines, and (M,) the line of each pixel, -1 for none


class LineFitter(Protocol):
    """Turns regions of edge pixels into segments."""

    def fit(self, edge: EdgePixels, descriptors: NDArray[np.float32], regions: NDArray[np.int32]) -> Fitted:
        """The N lines of the regions, and (M,) int32 the line of each pixel, -1 for none.

        Args:
            edge: M edge pixels.
            descriptors: (M, C) float32 unit rows.
            regions: (M,) int32 region of each pixel, -1 for none.
        """
        ...


@dataclass(frozen=True)
class TotalLeastSquaresFitter:
    """Weighted total least squares over sub-pixel ridge positions; weights are edge probabilities.

    A region that bends is cut at its farthest pixel from the chord and each part is fitted alone (Ramer 1972, Douglas
    and Peucker 1973). Neighbouring collinear lines are then joined: pixel moments add up, so a joint fit costs nothing.
    End points move on along the line while the edge map stays above half the line's mean strength: pixels near corners
    mix two orientations and belong to no region, yet the line runs on to the corner.
    """

    config: FitConfig = field(default_factory=FitConfig)
    team: ThreadTeam = field(default=ALONE, repr=False, compare=False)

    def fit(self, edge: EdgePixels, descriptors: NDArray[np.float32], regions: NDArray[np.int32]) -> Fitted:
        """See `LineFitter.fit`."""
        order, offsets = group(regions)
        parts = split_regions(edge.positions, edge.weights, order, offsets, self.config.max_deviation, self.team)
        merged = join_collinear(parts[2], self.config)
        return self.choose(edge.support, descriptors, parts, merged)

    def choose(
        self, support: NDArray[np.float32], descriptors: NDArray[np.float32], parts: Parts, merged: NDArray[np.int64]
    ) -> Fitted:
        """The second half of `fit`: end points, scores, and which parts are lines.

        Args:
            support: (H, W) the edge map.
            descriptors: (M, C) of all pixels.
            parts: of `split_regions`; their end points are changed.
            merged: of `join_collinear`.
        """
        rows, bounds, moments = parts
        config, scores = self.config, np.empty(len(moments), np.float32)

        def extend_and_score(start: int, end: int) -> None:
            extend_ends(moments, merged, support, config.max_reach, start, end)
            score_parts(moments, merged, support, scores, start, end)

        self.team.map_range(len(moments), 32, extend_and_score)
        lines_of, segments, scores, residuals = _choose(moments, merged, scores, config.min_length, config.min_score)
        labels, means = _vote(rows, bounds, lines_of, descriptors, len(segments), _channels(descriptors))
        return LineSet(segments, scores, means, residuals), labels


@dataclass(frozen=True)
class PaperFitter:
    """The paper's voting (equation 5), with each vector turned to agree with the running sum.

    As printed, the tangent `sum(x - m)` is zero; so, as in the released code, the sign of each vector is flipped
    where it opposes the sum so far. The end points are the projection of the farthest pixel, to both sides.
    """

    def fit(self, edge: EdgePixels, descriptors: NDArray[np.float32], regions: NDArray[np.int32]) -> Fitted:
        """See `LineFitter.fit`."""
        order, offsets = group(regions)
        segments = _paper_fit(edge.positions, order, offsets)
        scores = line_scores(edge.support, segments.reshape(-1, 4))
        numbers = np.arange(len(segments), dtype=np.int32)
        bounds = np.stack([offsets[:-1], offsets[1:]], axis=1)
        _, means = _vote(order, bounds, numbers, descriptors, len(segments), _channels(descriptors))
        return LineSet(segments, scores, means), regions


def _channels(descriptors: NDArray[np.float32]) -> tuple[int, ...]:
    """(0, 1, ..., C - 1): a tuple, since numba unrolls loops over those."""
    return tuple(range(descriptors.shape[1]))


@njit()
def group(labels):  # type: ignore[no-untyped-def]
    """Rows sorted by (M,) int32 label: order, (M,) int64, of which label k owns `order[offsets[k]:offsets[k + 1]]`.

    Rows of label -1 come first; all keep their order.
    """
    last = -1
    for label in labels:
        last = max(last, label)
    offsets = np.zeros(last + 3, np.int64)
    for label in labels:
        offsets[label + 2] += 1
    for k in range(1, last + 3):
        offsets[k] += offsets[k - 1]
    order = np.empty(len(labels), np.int64)
    following = offsets.copy()
    for row in range(len(labels)):
        place = labels[row] + 1
        order[following[place]] = row
        following[place] += 1
    return order, offsets[1:].copy()


@njit()
def _vote(rows, bounds, lines_of, descriptors, count, channels):  # type: ignore[no-untyped-def]
    """(M,) int32 line of each pixel by its part, -1 for none, and (N, C) float32 unit mean descriptor of each line.

    Args:
        rows, bounds: (K,) and (P, 2) int64, see `split_regions`.
        lines_of: (P,) int32 line of each part, -1 for none.
        descriptors: (M, C) float32.
        count: N.
        channels: see `_channels`.
    """
    labels = np.full(len(descriptors), -1, np.int32)
    sums = np.zeros((count, len(channels)), np.float32)
    for part in range(len(lines_of)):
        line = lines_of[part]
        if line < 0:
            continue
        total = sums[line]
        for k in range(bounds[part, 0], bounds[part, 1]):
            row = rows[k]
            labels[row] = line
            for c in range(len(channels)):
                total[c] += descriptors[row, c]
    for line in range(count):
        squared = np.float32(0)
        for c in range(len(channels)):
            squared += sums[line, c] * sums[line, c]
        norm = max(np.sqrt(squared), np.float32(1e-12))
        for c in range(len(channels)):
            sums[line, c] /= norm
    return labels, sums


@njit()
def _choose(moments, owner, scores, min_length, min_score):  # type: ignore[no-untyped-def]
    """(P,) int32 line of each part, -1 for none; segments, scores and residuals of the long and sure survivors."""
    count = len(moments)
    numbers = np.full(count, -1, np.int32)
    segments, sure, residuals = np.empty((count, 2, 2), np.float32), np.empty_like(scores), np.empty_like(scores)
    lines = 0
    for i in range(count):
        length = np.hypot(moments[i, 8] - moments[i, 6], moments[i, 9] - moments[i, 7])
        if owner[i] == i and length >= min_length and scores[i] >= min_score:
            numbers[i] = lines
            for end in range(2):
                segments[lines, end, 0], segments[lines, end, 1] = moments[i, 6 + 2 * end], moments[i, 7 + 2 * end]
            sure[lines], residuals[lines] = scores[i], residual(moments[i])
            lines += 1
    for i in range(count):
        root = i
        while owner[root] != root:
            root = owner[root]
        numbers[i] = numbers[root]
    return numbers, segments[:lines].copy(), sure[:lines].copy(), residuals[:lines].copy()


@njit()
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

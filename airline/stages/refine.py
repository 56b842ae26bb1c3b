"""Stage 5: lines moved by fractions of a pixel to where the image changes fastest.

A line is cut into chunks; the profiles across a chunk are averaged; the extremum of the mean profile's slope gives the
chunk's offset, and its error follows from the profiles' scatter. One weighted least-squares fit of shift and turn,
drawn towards zero, then moves the line: much where the image is clear, hardly where it is not.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from airline.config import RefineConfig
from airline.image import Gray, to_uint8
from airline.kernels.compiled import njit
from airline.kernels.sampling import interpolate, into_image, pack_neighbours, place_samples
from airline.kernels.threads import ALONE, ThreadTeam
from airline.lines import LineSet

CHUNK = 8.0  # px, length over which profiles are averaged
MIN_LENGTH = 10.0  # px; shorter lines stay where they are
PRIOR = 0.15  # px, standard deviation expected of a line's offset in the edge map
CHUNK_ERROR = 0.1  # px, standard deviation of a chunk's offset without noise: edges are not quite straight
ACROSS = 6  # samples across a line, 1 px apart
MARGIN = 3  # px that a profile reaches to either side
ROUNDING = 0.3  # grey levels squared, variance of a difference of two exact neighbours
TWO, THREE, FOUR, FIVE = (np.uint64(value) for value in (2, 3, 4, 5))


class Refiner(Protocol):
    """Moves lines to where the image has them."""

    def refine(self, lines: LineSet, gray: Gray) -> LineSet:
        """The N lines at their refined places in a (H, W) uint8 or uint16 image."""
        ...


@dataclass(frozen=True)
class ImageRefiner:
    """Moves lines to the extremum of the grey levels' slope across them."""

    config: RefineConfig = field(default_factory=RefineConfig)
    team: ThreadTeam = field(default=ALONE, repr=False, compare=False)

    def refine(self, lines: LineSet, gray: Gray) -> LineSet:
        """The N lines at their refined places in a (H, W) uint8 or uint16 image."""
        height, width = gray.shape
        if self.config.max_shift == 0 or min(height, width) <= 2 * MARGIN:
            return lines
        segments, packed, most = lines.segments.copy(), pack_neighbours(to_uint8(gray)), self.config.max_shift
        self.team.map_range(
            len(segments), 32, lambda start, end: _refine(packed, width, height, segments[start:end], most)
        )
        return replace(lines, segments=segments)


@njit()
def _refine(packed, width, height, segments, max_shift):  # type: ignore[no-untyped-def]
    """Move (N, 2, 2) float32 segments in place; the image as of `pack_neighbours`."""
    longest = np.hypot(width, height)  # what is longer lies outside
    most = ACROSS * (int(longest) + 1)
    places, work = np.empty(most, np.int32), np.empty(2 * most, np.float32)
    for line in segments:
        x0, y0 = np.float64(line[0, 0]), np.float64(line[0, 1])
        dx, dy = line[1, 0] - x0, line[1, 1] - y0
        length = np.hypot(dx, dy)
        if not MIN_LENGTH <= length <= longest:
            continue
        ux, uy = dx / length, dy / length
        chunks = int(length / CHUNK) + 1
        each = int(length / chunks)  # samples of a chunk
        count = chunks * each
        apart = length / count
        x0, y0 = x0 + 0.5 * apart * ux, y0 + 0.5 * apart * uy
        dx, dy = np.float32(apart * ux), np.float32(apart * uy)
        for j in range(ACROSS):
            across = j - 0.5 * (ACROSS - 1)
            x, y = np.float32(x0 - across * uy), np.float32(y0 + across * ux)
            place_samples(width, height, x, y, dx, dy, j * count, count, places, work)
        interpolate(packed, ACROSS * count, places, work)
        # normal equations of offset = shift + turn * t, t from -1/2 to 1/2 along the line; the priors make them regular
        s00, s01, s11, m0, m1 = PRIOR**-2.0, 0.0, 0.25 * PRIOR**-2.0, 0.0, 0.0
        for k in range(chunks):
            first, last = _inside(width, height, x0, y0, apart * ux, apart * uy, k * each, (k + 1) * each)
            offset, variance = _chunk(work, count, first, last)
            if variance >= 0:
                weight, t = 1 / (variance + CHUNK_ERROR**2), (k + 0.5) / chunks - 0.5
                s00 += weight
                s01 += weight * t
                s11 += weight * t * t
                m0 += weight * offset
                m1 += weight * offset * t
        det = s00 * s11 - s01 * s01
        shift, turn = (s11 * m0 - s01 * m1) / det, (s00 * m1 - s01 * m0) / det
        if abs(shift) + 0.5 * abs(turn) <= max_shift:
            for end in range(2):
                offset = shift + (end - 0.5) * turn
                line[end, 0] = into_image(line[end, 0] - offset * uy, width)
                line[end, 1] = into_image(line[end, 1] + offset * ux, height)


@njit(inline="always")
def _inside(width, height, x, y, dx, dy, start, end):  # type: ignore[no-untyped-def]
    """Those of a line's samples `start` to `end` whose whole profile lies in the image: the first, and the last + 1."""
    while start < end and not _has_profile(width, height, x + start * dx, y + start * dy):
        start += 1
    while start < end and not _has_profile(width, height, x + (end - 1) * dx, y + (end - 1) * dy):
        end -= 1
    return start, end


@njit(inline="always")
def _has_profile(width, height, x, y):  # type: ignore[no-untyped-def]
    return (MARGIN <= x < width - 1 - MARGIN) and (MARGIN <= y < height - 1 - MARGIN)


@njit(inline="always")
def _chunk(levels, count, start, end):  # type: ignore[no-untyped-def]
    """Offset of the edge across a chunk and its variance, px and px squared; variance -1 where it cannot be told.

    `levels` float32 are `count` samples along the line at -2.5 px across it, then as many at -1.5 px, to 2.5 px.
    """
    if end - start < 2:
        return 0.0, -1.0
    zero = np.float32(0)
    p0, p1, p2, p3, p4, p5, squares = zero, zero, zero, zero, zero, zero, zero
    row = np.uint64(count)
    for k in range(start, end):
        place = np.uint64(k)
        p0 += levels[place]
        p1 += levels[place + row]
        left, right = levels[place + TWO * row], levels[place + THREE * row]
        p2 += left
        p3 += right
        p4 += levels[place + FOUR * row]
        p5 += levels[place + FIVE * row]
        squares += (right - left) * (right - left)
    samples = end - start
    middle = (p3 - p2) / samples  # mean difference of the two beside the line
    variance = max(squares / samples - middle * middle, 0.0) + ROUNDING
    # the slope at -1, 0 and 1 px, smoothed by (1 2 1)
    a, b, c = (p3 + p2 - p1 - p0) / samples, (p4 + p3 - p2 - p1) / samples, (p5 + p4 - p3 - p2) / samples
    if b < 0:
        a, b, c = -a, -b, -c
    if min(a, b, c) <= 0:
        return 0.0, -1.0
    # a smoothed edge's slope is nearly a Gaussian, whose logarithm is a parabola
    before, after = np.log(a / b), np.log(c / b)
    curvature = before + after
    if curvature >= -1e-6:
        return 0.0, -1.0
    offset = 0.5 * (before - after) / curvature
    if abs(offset) > 1:
        return 0.0, -1.0
    # of 0.5 (c - a) / b, were the differences independent
    return offset, 2.5 * variance / (samples * b * b * curvature * curvature)

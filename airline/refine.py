"""Stage 5: lines moved by fractions of a pixel to where the image changes fastest.

The edge map knows which structure is a line, and in the dark it is all there is; where exactly the line runs, the grey
levels tell better. A line is cut into chunks; the profiles across a chunk are averaged, so that noise cancels; the
extremum of the mean profile's slope gives the chunk's offset, and its error follows from the profiles' scatter. One
weighted least-squares fit of shift and turn, drawn towards zero, then moves the line: much where the image is clear,
hardly where it is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from airline.compiled import njit
from airline.errors import ConfigError
from airline.image import Gray, to_uint8
from airline.lines import LineSet
from airline.score import between

CHUNK = 8.0  # px, length over which profiles are averaged
MIN_LENGTH = 10.0  # px; shorter lines stay where they are
PRIOR = 0.15  # px, standard deviation expected of a line's offset in the edge map
CHUNK_ERROR = 0.1  # px, standard deviation of a chunk's offset without noise: edges are not quite straight
ROUNDING = 0.3  # grey levels squared, variance of a difference of two exact neighbours


@dataclass(frozen=True)
class ImageRefiner:
    """Moves lines to the extremum of the grey levels' slope across them.

    Attributes:
        max_shift: a line of which an end point would move by more than this stays where it is, px; 0 moves none.
    """

    max_shift: float = 0.5

    def __post_init__(self) -> None:
        if self.max_shift < 0:
            raise ConfigError("refine needs a max_shift of at least 0 px")

    def refine(self, lines: LineSet, gray: Gray) -> LineSet:
        """The lines at their refined places.

        Args:
            lines: N lines, px.
            gray: (H, W) uint8 or uint16, the image.
        """
        if self.max_shift == 0:
            return lines
        segments = lines.segments.copy()
        _refine(to_uint8(gray), segments, self.max_shift)
        return replace(lines, segments=segments)


@njit(cache=True, nogil=True)
def _refine(image, segments, max_shift):  # type: ignore[no-untyped-def]
    height, width = image.shape
    for line in segments:
        dx, dy = line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
        length = np.hypot(dx, dy)
        if length < MIN_LENGTH:
            continue
        ux, uy = dx / length, dy / length
        chunks = int(length / CHUNK) + 1
        step = length / chunks
        # normal equations of offset = shift + turn * t, t from -1/2 to 1/2 along the line; the priors make them regular
        s00, s01, s11, m0, m1 = PRIOR**-2.0, 0.0, 0.25 * PRIOR**-2.0, 0.0, 0.0
        for k in range(chunks):
            offset, variance = _chunk(image, line[0, 0] + k * step * ux, line[0, 1] + k * step * uy, ux, uy, step)
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
                line[end, 0] = min(max(line[end, 0] - offset * uy, -0.5), width - 0.5)
                line[end, 1] = min(max(line[end, 1] + offset * ux, -0.5), height - 0.5)


@njit(cache=True, nogil=True)
def _chunk(image, x0, y0, ux, uy, length):  # type: ignore[no-untyped-def]
    """Offset of the edge across a chunk and its variance, px and px squared; variance -1 where it cannot be told."""
    height, width = image.shape
    samples = int(length)
    slope = np.zeros(5)  # mean difference of neighbours across the line, at -2, -1, 0, 1, 2 px
    squares, count = 0.0, 0
    for k in range(samples):
        t = (k + 0.5) * length / samples
        x, y = x0 + t * ux, y0 + t * uy
        if not (3 <= x < width - 4 and 3 <= y < height - 4):
            continue
        last = 0.0
        for j in range(6):
            value = between(image, x - (j - 2.5) * uy, y + (j - 2.5) * ux)
            if j > 0:
                slope[j - 1] += value - last
            if j == 3:
                squares += (value - last) ** 2
            last = value
        count += 1
    if count < 2:
        return 0.0, -1.0
    slope /= count
    variance = max(squares / count - slope[2] ** 2, 0.0) + ROUNDING
    if slope[1] + 2 * slope[2] + slope[3] < 0:
        slope = -slope
    a = slope[0] + 2 * slope[1] + slope[2]
    b = slope[1] + 2 * slope[2] + slope[3]
    c = slope[2] + 2 * slope[3] + slope[4]
    if min(a, b, c) <= 0:
        return 0.0, -1.0
    # a smoothed edge's slope is nearly a Gaussian, whose logarithm is a parabola
    curvature = np.log(a) - 2 * np.log(b) + np.log(c)
    if curvature >= -1e-6:
        return 0.0, -1.0
    offset = 0.5 * (np.log(a) - np.log(c)) / curvature
    if abs(offset) > 1:
        return 0.0, -1.0
    # of 0.5 (c - a) / b, were the differences independent
    return offset, 2.5 * variance / (count * b * b * curvature * curvature)

"""How far measured lines err, and which part of a line is in the image.

A line's errors are its offset across itself at its middle, px, and its angle, radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit

CORRELATION = 8.0  # px of a line's length that err alike: pixels share their neighbourhood
FLOOR = 0.03  # px, standard deviation of an offset that no length takes away
BIAS = 0.12  # px, standard deviation of an offset that stays over the frames, as measured on rendered clips
BLUR = 0.02  # px of bias per px of motion across a line from frame to frame
MEASURED = 0.25  # px, standard deviation of a line measured on the edge map beyond that
DEFAULT_RESIDUAL = 0.5  # px, of detectors that do not report theirs


def line_covariances(
    segments: NDArray[np.float32], residuals: NDArray[np.float32] | None, more: float = 0.0
) -> NDArray[np.float32]:
    """Covariances of lines fitted to independent stretches of an edge.

    Of n = length / 8 stretches with standard deviation s, evenly along the line: var(offset) = s^2 / n and
    var(angle) = 12 s^2 / (n length^2), the textbook result for a straight-line fit; a floor is added to both.

    Args:
        segments: (N, 2, 2) float32 px.
        residuals: (N,) float32 rms distance of the pixels from their line, px; None if not known.
        more: px, standard deviation of what else there is.

    Returns:
        (N, 2, 2) float32 covariance of (offset at the middle, px; angle, radians).
    """
    delta = segments[:, 1] - segments[:, 0]
    length = np.maximum(np.hypot(delta[:, 0], delta[:, 1]), 1.0)
    spread = np.full(len(segments), DEFAULT_RESIDUAL) if residuals is None else residuals
    offset = spread**2 / np.maximum(length / CORRELATION, 1.0) + FLOOR**2 + more**2
    covariances = np.zeros((len(segments), 2, 2), np.float32)
    covariances[:, 0, 0], covariances[:, 1, 1] = offset, 12 * offset / length**2
    return covariances


def with_bias(covariances: NDArray[np.float32], across: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, 2, 2) covariances with the part of the errors that no averaging takes away.

    Args:
        covariances: (N, 2, 2) float32.
        across: (N,) float32 px that the lines moved across themselves since the last frame, which blurs them.
    """
    biased = covariances.copy()
    biased[:, 0, 0] += BIAS**2 + (BLUR * across) ** 2
    return biased


def visible_parts(
    segments: NDArray[np.floating], size: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Which parts of segments lie inside the image.

    Args:
        segments: (N, 2, 2) px.
        size: (width, height), px.

    Returns:
        (N,) where along each segment its part begins and ends, from 0 to 1, and its length, px; 0, 1 and length 0 where
        nothing is inside.
    """
    low, high, lengths = np.zeros(len(segments)), np.ones(len(segments)), np.zeros(len(segments))
    _visible(segments, low, high, lengths, size[0], size[1])
    return low, high, lengths


@njit()
def _visible(segments, lows, highs, lengths, width, height):  # type: ignore[no-untyped-def]
    for n in range(len(segments)):
        x, y = np.float64(segments[n, 0, 0]), np.float64(segments[n, 0, 1])
        dx, dy = segments[n, 1, 0] - x, segments[n, 1, 1] - y
        length = np.hypot(dx, dy)
        if not length > 0:
            continue
        low, high = inside(x, y, dx / length, dy / length, 0.0, length, width, height)
        if high > low:
            lows[n], highs[n], lengths[n] = low / length, high / length, high - low


@njit()
def inside(x, y, ux, uy, low, high, width, height):  # type: ignore[no-untyped-def]
    """The part of [low, high] along the line (x, y) + t (ux, uy) that lies in the image; empty if the last is less."""
    for start, step, limit in ((x, ux, width - 0.5), (y, uy, height - 0.5)):
        if abs(step) > 1e-9:
            a, b = (-0.5 - start) / step, (limit - start) / step
            low, high = max(low, min(a, b)), min(high, max(a, b))
        elif start < -0.5 or start > limit:
            return 0.0, -1.0
    return low, high

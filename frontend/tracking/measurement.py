"""How far measured lines err.

A line's errors are its offset across itself at its middle, px, and its angle, radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CORRELATION = 8.0  # px of a line's length that err alike: pixels share their neighbourhood
FLOOR = 0.03  # px, standard deviation of an offset that no length takes away
BIAS = 0.12  # px, standard deviation of an offset that stays over the frames, as measured on rendered clips
BLUR = 0.02  # px of bias per px of motion across a line from frame to frame
RESTING = 0.1  # px of motion across itself from frame to frame, below which a line rests,
SAME = 0.5  # and this share of its angle's variance comes back in every frame: the pixels are the same
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


def with_rest(
    covariances: NDArray[np.float32], errors: NDArray[np.float32], across: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(N, 2, 2) covariances of fused lines with the angle's errors that averaging did not take away, since they rest.

    What stays of an offset's errors is the bias.

    Args:
        covariances: (N, 2, 2) float32, as of independent errors.
        errors: (N, 2, 2) float32 covariances of the last measurements.
        across: (N,) float32 px that the lines moved across themselves since the last frame.
    """
    resting = covariances.copy()
    resting[:, 1, 1] += SAME * (across < RESTING) * errors[:, 1, 1]
    return resting

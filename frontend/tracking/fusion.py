"""A track's line from where it should be and where it was seen: a Kalman filter across, slow extents along.

A line's errors are its offset across itself at its middle, px, and its angle, radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit

CORRELATION = 8.0  # px of a line's length that err alike: pixels share their neighbourhood
FLOOR = 0.03  # px, standard deviation of an offset that no length takes away
BIAS = 0.12  # px, standard deviation of an offset that stays over the frames, as measured on rendered clips
DEFAULT_RESIDUAL = 0.5  # px, of detectors that do not report theirs
STILL, PER_PIXEL, UNFOLLOWED = 0.03, 0.02, 1.0  # px, error of a prediction: always, per px of motion, without flow
NEAR, NEAR_SHARE = 3.0, 0.1  # end points that move by less, px or share of the length, are noise
GAIN_NEAR, GAIN_OUT, GAIN_IN = 0.25, 0.8, 0.12  # of end points: for noise, for what is newly seen, for what is not seen


def line_covariances(segments: NDArray[np.float32], residuals: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """Covariances of lines fitted to independent stretches of an edge.

    Of n = length / 8 stretches with standard deviation s, evenly along the line: var(offset) = s^2 / n and
    var(angle) = 12 s^2 / (n length^2), the textbook result for a straight-line fit; a floor is added to both.

    Args:
        segments: (N, 2, 2) float32 px.
        residuals: (N,) float32 rms distance of the pixels from their line, px; None if not known.

    Returns:
        (N, 2, 2) float32 covariance of (offset at the middle, px; angle, radians).
    """
    delta = segments[:, 1] - segments[:, 0]
    length = np.maximum(np.hypot(delta[:, 0], delta[:, 1]), 1.0)
    spread = np.full(len(segments), DEFAULT_RESIDUAL) if residuals is None else residuals
    offset = spread**2 / np.maximum(length / CORRELATION, 1.0) + FLOOR**2
    covariances = np.zeros((len(segments), 2, 2), np.float32)
    covariances[:, 0, 0], covariances[:, 1, 1] = offset, 12 * offset / length**2
    return covariances


def with_bias(covariances: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, 2, 2) covariances of fused lines with the part of their error that no averaging takes away."""
    return covariances + np.array([[BIAS**2, 0], [0, 0]], np.float32)


def predicted_covariances(
    covariances: NDArray[np.float32],
    before: NDArray[np.float32],
    after: NDArray[np.float32],
    followed: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """(N, 2, 2) covariances after a prediction, which errs in proportion to how far (N, 2, 2) segments moved, px."""
    motion = np.abs(after - before).max(axis=(1, 2))
    error = STILL + PER_PIXEL * motion + np.where(followed, 0.0, UNFOLLOWED)
    delta = after[:, 1] - after[:, 0]
    length = np.maximum(np.hypot(delta[:, 0], delta[:, 1]), 1.0)
    grown = covariances.copy()
    grown[:, 0, 0] += error**2
    grown[:, 1, 1] += 12 * (error / length) ** 2
    return grown


def fuse(
    predicted: NDArray[np.float32],
    predicted_covariances: NDArray[np.float32],
    measured: NDArray[np.float32],
    measured_covariances: NDArray[np.float32],
    size: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The lines that follow from prediction and measurement.

    Across itself a line is filtered (Kalman 1960, with offset and angle as state). Along it the extent grows at once
    when more of the line is seen, and shrinks slowly when less is, since a line breaks more often than it ends.

    Args:
        predicted: (N, 2, 2) float32 px, with (N, 2, 2) covariances.
        measured: (N, 2, 2) float32 px, with (N, 2, 2) covariances; the same direction as the prediction.
        size: (width, height) of the image, px; extents end at its border.

    Returns:
        (N, 2, 2) float32 segments, and their (N, 2, 2) float32 covariances.
    """
    segments, covariances = np.empty_like(predicted), np.empty_like(predicted_covariances)
    _fuse(predicted, predicted_covariances, measured, measured_covariances, size[0], size[1], segments, covariances)
    return segments, covariances


@njit()
def _fuse(predicted, before, measured, noise, width, height, segments, covariances):  # type: ignore[no-untyped-def]
    for n in range(len(predicted)):
        p, m = predicted[n].astype(np.float64), measured[n].astype(np.float64)
        cx, cy = 0.5 * (m[0, 0] + m[1, 0]), 0.5 * (m[0, 1] + m[1, 1])
        angle = np.arctan2(p[1, 1] - p[0, 1], p[1, 0] - p[0, 0])
        ux, uy = np.cos(angle), np.sin(angle)
        px, py = 0.5 * (p[0, 0] + p[1, 0]), 0.5 * (p[0, 1] + p[1, 1])
        lever = (cx - px) * ux + (cy - py) * uy
        # the prediction's covariance at the measurement's middle
        c11 = before[n, 1, 1]
        c01 = before[n, 0, 1] + lever * c11
        c00 = before[n, 0, 0] + 2 * lever * before[n, 0, 1] + lever * lever * c11
        s00, s01, s11 = c00 + noise[n, 0, 0], c01 + noise[n, 0, 1], c11 + noise[n, 1, 1]
        det = s00 * s11 - s01 * s01
        k00, k01 = (c00 * s11 - c01 * s01) / det, (c01 * s00 - c00 * s01) / det
        k10, k11 = (c01 * s11 - c11 * s01) / det, (c11 * s00 - c01 * s01) / det
        offset = (cy - py) * ux - (cx - px) * uy
        turn = np.arctan2(m[1, 1] - m[0, 1], m[1, 0] - m[0, 0]) - angle
        turn -= 2 * np.pi * np.floor(turn / (2 * np.pi) + 0.5)
        shift = k00 * offset + k01 * turn
        angle += k10 * offset + k11 * turn
        # a point of the fused line: the foot of the measurement's middle on the prediction, shifted
        fx, fy = cx + (offset - shift) * uy, cy - (offset - shift) * ux
        ux, uy = np.cos(angle), np.sin(angle)
        ends, near = np.empty(2, np.float64), max(NEAR, NEAR_SHARE * np.hypot(p[1, 0] - p[0, 0], p[1, 1] - p[0, 1]))
        for end in range(2):
            sign = 2 * end - 1
            old = sign * ((p[end, 0] - fx) * ux + (p[end, 1] - fy) * uy)
            new = sign * ((m[end, 0] - fx) * ux + (m[end, 1] - fy) * uy)
            gain = GAIN_NEAR if abs(new - old) <= near else GAIN_OUT if new > old else GAIN_IN
            ends[end] = sign * (old + gain * (new - old))
        low, high = inside(fx, fy, ux, uy, ends[0], ends[1], width, height)
        if high <= low:
            low, high = ends[0], ends[1]
        segments[n, 0, 0], segments[n, 0, 1] = fx + low * ux, fy + low * uy
        segments[n, 1, 0], segments[n, 1, 1] = fx + high * ux, fy + high * uy
        a00, a01, a11 = c00 - k00 * c00 - k01 * c01, c01 - k00 * c01 - k01 * c11, c11 - k10 * c01 - k11 * c11
        lever = 0.5 * (low + high)
        covariances[n, 0, 0] = a00 + 2 * lever * a01 + lever * lever * a11
        covariances[n, 0, 1] = covariances[n, 1, 0] = a01 + lever * a11
        covariances[n, 1, 1] = a11


def clip(segments: NDArray[np.float32], size: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The parts of segments inside the image.

    Args:
        segments: (N, 2, 2) float32 px.
        size: (width, height), px.

    Returns:
        (N, 2, 2) float32 px, as they are where nothing is inside, and (N,) float32 the length inside, px.
    """
    clipped, lengths = segments.copy(), np.zeros(len(segments), np.float32)
    _clip(clipped, lengths, size[0], size[1])
    return clipped, lengths


@njit()
def _clip(segments, lengths, width, height):  # type: ignore[no-untyped-def]
    for n in range(len(segments)):
        x, y = np.float64(segments[n, 0, 0]), np.float64(segments[n, 0, 1])
        dx, dy = segments[n, 1, 0] - x, segments[n, 1, 1] - y
        length = np.hypot(dx, dy)
        if not length > 0:
            continue
        ux, uy = dx / length, dy / length
        low, high = inside(x, y, ux, uy, 0.0, length, width, height)
        if high > low:
            segments[n, 0, 0], segments[n, 0, 1] = x + low * ux, y + low * uy
            segments[n, 1, 0], segments[n, 1, 1] = x + high * ux, y + high * uy
            lengths[n] = high - low


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

"""Partners moved to where the right image is most like the left one: disparities to fractions of a pixel.

Lucas and Kanade's method (1981) along the rows, in two unknowns per line, the disparities of its ends: Gauss and
Newton's steps on the grey levels around the line, with Tukey's weights for what is hidden or moves on its own, and with
the two detected lines as a prior; depths change little along short lines. How far a disparity errs is what the slopes
and differences of the grey levels say: the inverse of the last normal equations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from frontend.camera.model import CameraModel
from frontend.stereo.disparity import detection_errors, disparities, own_covariances

ACROSS = np.arange(-3.0, 4.0)  # px from the line
SPACING, LEAST, MOST = 6.0, 6, 16  # px between stations along the line, and how many it has
STEPS = 2
REACH = 30.0  # grey levels: what differs by more shows something else
NOISE = 6.0  # grey levels, standard deviation of what does not, for a sample
LEAST_NOISE, ALIKE = 2.0, 12.0  # the same as a line shows it, and how many samples err alike
ERRORS, FLOOR = 1.4, 0.09  # of variances beyond that, and px that nothing takes away, as measured on rendered pairs
SLOPE, LEAST_BEND = 1.0, 0.05  # of inverse depth along a line as long as the focal length, in its own unit; and px
FARTHEST = 2.0  # px that a disparity may change

Float32 = NDArray[np.float32]
Array = NDArray[np.float64]


def aligned(
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    gain: tuple[float, float],
    left: tuple[Float32, Float32],
    right: tuple[Float32, Float32],
    camera: CameraModel,
) -> tuple[Float32, Float32, Array]:
    """Right lines, moved along their rows to where the images agree with them and with each other.

    Args:
        images: (H, W) left and right one.
        gain: by which right grey levels become left ones, and what is added.
        left, right: (N, 2, 2) lines, px, and their (N, 2, 2) covariances; NaN where there is no right line.
        camera: of the pair, or a guess of one.

    Returns:
        (N, 2, 2) float32 px, their (N, 2, 2) covariances, those of the left lines and what is their own, and (N, 2) px
        disparities of the left ends; lines along the rows are as they were, and have none.
    """
    before, prior = disparities(*left, *right, camera.disparity_offset)[0], detection_errors(*left, *right)
    rows = np.flatnonzero(np.isfinite(before).all(axis=1))
    segments, theirs, known, prior = left[0][rows], right[0][rows], before[rows].astype(np.float64), prior[rows]
    ends = segments.astype(np.float64)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    bend = SLOPE * np.abs(known.mean(axis=1) - camera.disparity_offset) * length / camera.fx + LEAST_BEND
    found, spread = known.copy(), np.empty_like(prior)
    _align(*images, ends, found, np.linalg.inv(prior), 1 / bend**2, *gain, spread)
    shift, along = known - found, (theirs[..., 1] - ends[:, :1, 1]) / (ends[:, 1:, 1] - ends[:, :1, 1])
    moved = theirs.copy()
    moved[:, :, 0] += (shift[:, :1] + along * (shift[:, 1:] - shift[:, :1])).astype(np.float32)
    own = own_covariances(segments, moved, spread)
    turned = np.isnan(own).any(axis=(1, 2))  # along the rows
    astray = turned | (np.abs(shift) > FARTHEST).any(axis=1)
    moved[astray], found[astray] = theirs[astray], known[astray]
    own[astray] = own_covariances(segments[astray], theirs[astray], prior[astray])
    others, errors, ends_disparity = right[0].copy(), right[1].copy(), np.full(before.shape, np.nan)
    others[rows], errors[rows], ends_disparity[rows] = moved, left[1][rows] + own, found
    return others, errors, ends_disparity


@njit()
def _align(image, other, segments, found, information, bends, gain, lift, spread):  # type: ignore[no-untyped-def]
    most = MOST * len(ACROSS)
    x, y, s, here, slope = np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    for i in range(len(segments)):
        x0, y0 = segments[i, 0]
        dx, dy = segments[i, 1, 0] - x0, segments[i, 1, 1] - y0
        length = max(np.hypot(dx, dy), 1e-6)
        stations = min(max(int(length / SPACING), LEAST), MOST)
        count = 0
        for k in range(stations):
            for c in range(len(ACROSS)):
                s[count] = (k + 0.5) / stations
                x[count] = x0 + s[count] * dx - ACROSS[c] * dy / length
                y[count] = y0 + s[count] * dy + ACROSS[c] * dx / length
                here[count], slope[count] = _level_and_slope(image, x[count], y[count])
                count += 1
        first, last = found[i]
        p00, p01, p11 = information[i, 0, 0], information[i, 0, 1], information[i, 1, 1]
        prior0, prior1 = p00 * first + p01 * last, p01 * first + p11 * last
        p00, p01, p11 = p00 + bends[i], p01 - bends[i], p11 + bends[i]
        for step in range(STEPS + 1):
            h00, h01, h11, g0, g1, weights, squares = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(count):
                at = x[k] - first - s[k] * (last - first)
                there, other_slope = _level_and_slope(other, at, y[k])
                error = lift + gain * there - here[k]
                if abs(error) >= REACH:
                    continue
                weight = (1 - (error / REACH) ** 2) ** 2
                change = -0.5 * (gain * other_slope + slope[k])  # of both, as in symmetric alignment
                h00 += weight * change * change * (1 - s[k]) ** 2
                h01 += weight * change * change * s[k] * (1 - s[k])
                h11 += weight * change * change * s[k] ** 2
                g0 += weight * change * error * (1 - s[k])
                g1 += weight * change * error * s[k]
                weights += weight
                squares += weight * error * error
            ended = step == STEPS
            noise = ALIKE * max(squares / max(weights, 1e-9), LEAST_NOISE**2) if ended else NOISE**2
            h00, h01, h11 = h00 / noise + p00, h01 / noise + p01, h11 / noise + p11
            det = h00 * h11 - h01 * h01
            if ended:
                spread[i, 0, 0], spread[i, 1, 1] = ERRORS * h11 / det + FLOOR**2, ERRORS * h00 / det + FLOOR**2
                spread[i, 0, 1] = spread[i, 1, 0] = FLOOR**2 - ERRORS * h01 / det
                break
            g0 = g0 / noise + p00 * first + p01 * last - prior0
            g1 = g1 / noise + p01 * first + p11 * last - prior1
            first -= min(max((h11 * g0 - h01 * g1) / det, -1.0), 1.0)
            last -= min(max((h00 * g1 - h01 * g0) / det, -1.0), 1.0)
        found[i, 0], found[i, 1] = first, last


@njit(inline="always")
def _level_and_slope(image, x, y):  # type: ignore[no-untyped-def]
    """Mean grey level of a pixel's width along the row around a place, and its change across that; as at the border."""
    x, y = min(max(x - 0.5, 0.0), image.shape[1] - 2.001), min(max(y, 0.0), image.shape[0] - 1.001)
    column, row, one, two = np.uint64(x), np.uint64(y), np.uint64(1), np.uint64(2)
    fx, fy = x - np.float64(column), y - np.float64(row)
    below = row + one
    a = image[row, column] + fy * (np.float64(image[below, column]) - image[row, column])
    b = image[row, column + one] + fy * (np.float64(image[below, column + one]) - image[row, column + one])
    c = image[row, column + two] + fy * (np.float64(image[below, column + two]) - image[row, column + two])
    before, after = a + fx * (b - a), b + fx * (c - b)
    return 0.5 * (before + after), after - before

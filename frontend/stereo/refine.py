"""Partners moved to where the right image is most like the left one: disparities to a tenth of a pixel.

Lucas and Kanade's method (1981) along the rows, in two unknowns per line, the disparities of its ends: Gauss and
Newton's steps on the grey levels around the line, with Tukey's weights for what is hidden or moves on its own, and with
the two detected lines as a prior.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from frontend.stereo.votes import level

ACROSS = np.arange(-4.0, 5.0)  # px from the line
SPACING, LEAST, MOST = 4.0, 6, 24  # px between stations along the line, and how many it has
STEPS = 3
REACH = 30.0  # grey levels: what differs by more shows something else
NOISE = 8.0  # grey levels, standard deviation of what does not, for a sample; neighbours err alike
FARTHEST = 2.0  # px that a disparity may change

Array = NDArray[np.float64]


def refined(
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    segments: NDArray[np.float32],
    disparities: Array,
    covariances: Array,
    gain: tuple[float, float],
) -> Array:
    """Disparities of lines' ends that fit the images and what was known before.

    Args:
        images: (H, W) left and right one.
        segments: (N, 2, 2) px, left lines.
        disparities: (N, 2) px, of their ends, with `covariances` (N, 2, 2), px^2.
        gain: by which right grey levels become left ones, and what is added.

    Returns:
        (N, 2) px; as they were where the images do not agree.
    """
    found = disparities.copy()
    information = np.linalg.inv(covariances)
    _refine(*images, np.float64(segments), found, information, *gain)
    far = np.abs(found - disparities).max(axis=1) > FARTHEST
    found[far] = disparities[far]
    return found


@njit()
def _refine(image, other, segments, found, information, gain, lift):  # type: ignore[no-untyped-def]
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
                before, after = level(image, x[count] - 0.5, y[count]), level(image, x[count] + 0.5, y[count])
                here[count], slope[count] = 0.5 * (before + after), after - before
                count += 1
        first, last = found[i]
        weight_of_sample = 1 / NOISE**2
        for _ in range(STEPS):
            h00, h01, h11 = information[i, 0, 0], information[i, 0, 1], information[i, 1, 1]
            g0 = h00 * (first - found[i, 0]) + h01 * (last - found[i, 1])
            g1 = h01 * (first - found[i, 0]) + h11 * (last - found[i, 1])
            for k in range(count):
                at = x[k] - first - s[k] * (last - first)
                before, after = level(other, at - 0.5, y[k]), level(other, at + 0.5, y[k])
                error = lift + 0.5 * gain * (before + after) - here[k]
                if abs(error) >= REACH:
                    continue
                weight = (1 - (error / REACH) ** 2) ** 2 * weight_of_sample
                change = -0.5 * (gain * (after - before) + slope[k])  # of both, as in symmetric alignment
                h00 += weight * change * change * (1 - s[k]) ** 2
                h01 += weight * change * change * s[k] * (1 - s[k])
                h11 += weight * change * change * s[k] ** 2
                g0 += weight * change * error * (1 - s[k])
                g1 += weight * change * error * s[k]
            det = h00 * h11 - h01 * h01
            first -= min(max((h11 * g0 - h01 * g1) / det, -1.0), 1.0)
            last -= min(max((h00 * g1 - h01 * g0) / det, -1.0), 1.0)
        found[i, 0], found[i, 1] = first, last

"""What a line looks like from both sides: grey levels across it, averaged along it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from airline.kernels.sampling import place_samples, sum_samples

OFFSETS = np.array([-9.0, -6.0, -3.5, -1.5, 1.5, 3.5, 6.0, 9.0])  # px across the line
SPACING = 6.0  # px between samples along the line
MOST_SAMPLES = 16
HALF = np.float32(0.5)
FLOOR = 6.0  # grey levels: profiles with less contrast than this say little


def side_profiles(image: NDArray[np.uint8], segments: NDArray[np.float32]) -> NDArray[np.float32]:
    """Profiles across lines, from right to left of their direction, free of brightness and contrast.

    The mean is subtracted and the rest divided by its norm, with a floor, so that a dot product of two profiles is
    their correlation where there is contrast and tends to 0 where there is none. The two edges of a bar have profiles
    of opposite sign.

    Args:
        image: (H, W) uint8.
        segments: (N, 2, 2) float32 px.

    Returns:
        (N, 8) float32, rows of norm at most 1. The profile of a reversed segment is the reversed row.
    """
    if min(image.shape) < 2:
        return np.zeros((len(segments), len(OFFSETS)), np.float32)
    profiles: NDArray[np.float32] = _profiles(image.ravel(), image.shape[1], image.shape[0], segments)
    return profiles


@njit()
def _profiles(values, width, height, segments):  # type: ignore[no-untyped-def]
    profiles = np.zeros((len(segments), len(OFFSETS)), np.float32)
    places = np.empty(len(OFFSETS) * MOST_SAMPLES, np.int32)
    work = np.empty(2 * len(places), np.float32)
    for n in range(len(segments)):
        x0, y0 = segments[n, 0, 0], segments[n, 0, 1]
        dx, dy = segments[n, 1, 0] - x0, segments[n, 1, 1] - y0
        length = np.sqrt(dx * dx + dy * dy)
        if length < 1e-3:
            continue
        nx, ny = dy / length, -dx / length
        samples = min(max(2, int(length / SPACING)), MOST_SAMPLES)
        dx, dy = dx / np.float32(samples), dy / np.float32(samples)
        x0, y0 = x0 + HALF * dx, y0 + HALF * dy
        row = profiles[n]
        for c in range(len(OFFSETS)):
            x, y = np.float32(x0 - OFFSETS[c] * nx), np.float32(y0 - OFFSETS[c] * ny)
            place_samples(width, height, x, y, dx, dy, c * samples, samples, places, work)
        mean, squares = 0.0, FLOOR * FLOOR
        for c in range(len(OFFSETS)):
            row[c] = sum_samples(values, width, c * samples, samples, places, work) / samples
            mean += row[c] / len(OFFSETS)
        for c in range(len(OFFSETS)):
            row[c] -= mean
            squares += row[c] * row[c]
        for c in range(len(OFFSETS)):
            row[c] /= np.sqrt(squares)
    return profiles

"""End points, moved to where the edge ends (rows as in `airline.moments`)."""

from __future__ import annotations

import numpy as np
from numba import njit

FALL = 0.8  # px beyond its end where a ridge has fallen to half its height: 0.5 if binary, 1 if Gaussian
STEP = 0.5  # px


@njit(cache=True, nogil=True)
def reach(moments, owner, support, max_reach):  # type: ignore[no-untyped-def]
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

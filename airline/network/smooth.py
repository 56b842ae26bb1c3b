"""Means of squares, for the smoothed copies of the image that networks take."""

from __future__ import annotations

from typing import Any

import numpy as np

from airline.kernels.compiled import njit

ONE = np.float32(1)


@njit(fastmath=True)
def box_mean(image: Any, radius: int, means: Any) -> None:
    """Mean of the square around each pixel of an (h, w) float32 image, as far as the square lies in the image."""
    rows, columns = image.shape
    sums = np.zeros(columns + 2 * radius, np.float32)
    share = np.empty(columns, np.float32)
    for x in range(columns):
        share[x] = ONE / np.float32(min(x, radius) + min(columns - 1 - x, radius) + 1)
    middle = sums[radius : radius + columns]
    for y in range(rows):
        first, last = max(y - radius, 0), min(y + radius, rows - 1)
        for x in range(columns):
            middle[x] = 0
        for row in range(first, last + 1):
            line = image[row]
            for x in range(columns):
                middle[x] += line[x]
        target = means[y]
        for x in range(columns):
            target[x] = 0
        for shift in range(2 * radius + 1):
            moved = sums[shift : shift + columns]
            for x in range(columns):
                target[x] += moved[x]
        share_of_rows = ONE / np.float32(last - first + 1)
        for x in range(columns):
            target[x] *= share_of_rows * share[x]

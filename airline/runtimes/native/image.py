"""The image as the network's first layer takes it: 16-bit numbers, two channels of a pixel together."""

from __future__ import annotations

from typing import Any

import numpy as np

from airline.compiled import njit
from airline.runtimes.smooth import box_mean

QUARTER, HALF = np.float32(0.25), np.float32(0.5)


@njit(fastmath=True, inline="always")
def fill_rows(gray: Any, mean: Any, gain: Any, planes: Any, columns: int, first: int, last: int) -> None:
    """Fill rows `first` to `last` of the first layer's input.

    The image's last row and column are repeated as far as the network's stride needs, as by `UNet.answer`.

    Args:
        gray: (H, W) the image.
        mean: of its pixels, float32.
        gain: what a grey level above it becomes, float32.
        planes: (groups, rows + 2, stride, 2) int16: upper and lower pixels of the blocks of 2x2, then smoothed copies
            in pairs, not doubled as by `UNet._smoothed`; with a margin of a pixel, which stays as it is.
        columns: of blocks.
        first, last: of the rows without the margin.
    """
    height, width = gray.shape
    rows = planes.shape[1] - 2
    smoothed = 2 * (len(planes) - 2)
    reach = smoothed * (smoothed + 1) // 2
    start, end = max(first - reach, 0), min(last + reach, rows)
    means = np.empty((end - start, columns), np.float32)
    lines = np.empty((2, 2 * columns), np.float32)
    for y in range(start, end):
        for dy in range(2):
            line, source = lines[dy], gray[min(2 * y + dy, height - 1)]
            for x in range(width):
                line[x] = (np.float32(source[x]) - mean) * gain
            for x in range(width, 2 * columns):
                line[x] = line[width - 1]
            if first <= y < last:
                target = planes[dy, y + 1, 1:].reshape(-1)
                for x in range(2 * columns):
                    target[x] = np.int16(np.rint(line[x]))
        row, upper, lower = means[y - start], lines[0], lines[1]
        for x in range(columns):
            row[x] = (upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1]) * QUARTER
    for level in range(smoothed):
        finer, means = means, np.empty_like(means)
        box_mean(finer, level + 1, means)
        group, place = 2 + level // 2, level % 2
        for y in range(first, last):
            row, target = means[y - start], planes[group, y + 1, 1:].reshape(-1)
            for x in range(columns):
                target[2 * x + place] = np.int16(np.rint(row[x]))

"""The image as the network's first layer takes it: its pixels as they are, and smoothed copies in 16-bit numbers."""

from __future__ import annotations

import numpy as np

from airline.kernels.compiled import njit

GAIN = np.float32(128)  # what a grey level is in a smoothed copy
ONE, QUARTER = np.float32(1), np.float32(0.25)
FIRST, SECOND, THIRD, BYTE = np.uint32(8), np.uint32(16), np.uint32(24), np.uint32(255)
FOUR = np.uint32(0x01010101)  # times a byte: the byte four times


@njit(fastmath=True, inline="always")
def fill_rows(gray, mean, blocks, copies, columns, first, last):  # type: ignore[no-untyped-def]
    """Fill rows `first` to `last` of the first layer's input, and the margin beside them.

    Args:
        gray: (H, W) uint8, whose last row and column are repeated up to the network's stride.
        mean: of its pixels, float32.
        blocks: (rows + 2, stride) uint32, the four pixels of each block of 2x2, row by row; a margin of the mean.
        copies: (groups, rows + 2, stride, 2) int16, smoothed copies less the mean in pairs, not doubled as by
            `UNet._smoothed`; a margin of zeros.
        columns: of blocks.
        first, last: of the rows without the margin.
    """
    height, width = gray.shape
    rows, smoothed = len(blocks) - 2, 2 * len(copies)
    margin = np.uint32(np.rint(mean)) * FOUR
    for y in (0, rows + 1):
        if first <= min(max(y - 1, 0), rows - 1) < last:
            for x in range(columns + 2):
                blocks[y, x] = margin
    reach = smoothed * (smoothed + 1) // 2
    start, end = max(first - reach, 0), min(last + reach, rows)
    means = np.empty((end - start, columns), np.float32)
    lines = np.empty((2, 2 * columns), np.uint8)
    upper, lower = lines[0].view(np.uint16), lines[1].view(np.uint16)
    fours = np.empty(columns, np.uint32)
    for y in range(start, end):
        for dy in range(2):
            line, source = lines[dy], gray[min(2 * y + dy, height - 1)]
            for x in range(width):
                line[x] = source[x]
            for x in range(width, 2 * columns):
                line[x] = source[width - 1]
        for x in range(columns):
            fours[x] = np.uint32(upper[x]) | (np.uint32(lower[x]) << SECOND)
        if first <= y < last:
            target = blocks[y + 1]
            target[0], target[columns + 1] = margin, margin
            for x in range(columns):
                target[x + 1] = fours[x]
        row = means[y - start]
        for x in range(columns if smoothed else 0):
            four = fours[x]
            total = (four & BYTE) + ((four >> FIRST) & BYTE) + ((four >> SECOND) & BYTE) + (four >> THIRD)
            row[x] = (np.float32(np.int32(total)) * QUARTER - mean) * GAIN
    for level in range(smoothed):
        finer, means = means, np.empty_like(means)
        box_mean(finer, level + 1, means)
        for y in range(first, last):
            row, target = means[y - start], copies[level // 2, y + 1, 1:].reshape(-1)
            for x in range(columns):
                target[2 * x + level % 2] = np.int16(np.rint(row[x]))


@njit(fastmath=True, inline="always")
def box_mean(image, radius, means):  # type: ignore[no-untyped-def]
    """Mean of the square around each pixel, as far as the square lies in the image; both (h, w) float32."""
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

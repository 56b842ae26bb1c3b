"""The network from the image to the edge map, as phases of `scheduler`.

The first phase is the input; then comes a level after the other on the way down, each with the largest of each four
pixels for the next; then on the way up, and the last phase writes the edge map.
"""

from __future__ import annotations

import numpy as np

from airline.kernels.compiled import njit
from airline.network.native.image import fill_rows
from airline.network.native.microkernels import BYTES, FLOATS, LOGITS, PIXEL, fill
from airline.network.native.rows import add_rows, convolve, convolve_first, pool_rows
from airline.network.native.scheduler import bounds, finish, next_part, wait

# columns of the table of levels: rows and columns; from a row to the next, bytes; groups of channels; addresses of what
# its first layer takes, with a margin of a pixel, of the maps on the way down and up, and of smoothed copies
ROWS, COLUMNS, STRIDE, GROUPS, INPUT, DOWN, UP, COPIES = range(8)

HALF = np.float32(0.5)
# Lambert's continued fraction of tanh(t), nine terms: t * (A0 + A1 s + ...) / (A0 + B1 s + ...) with s = t * t; cut off
# where it reaches 1, it is 6e-6 off at most
A0, A1, A2, A3 = (np.float32(value) for value in (34459425, 4729725, 135135, 990))
B1, B2, B3, B4 = (np.float32(value) for value in (16216200, 945945, 13860, 45))
LIMIT = np.float32(6.28)


@njit(fastmath=True)
def take_image(gray, mean, blocks, copies, columns, marks, who, threads):  # type: ignore[no-untyped-def]
    """Our share of the first phase; arguments as of `fill_rows`."""
    for turn in range(marks.shape[1] - 1):
        part = next_part(marks, 0, turn, who, threads)
        if part >= 0:
            first, last = bounds(marks, len(blocks) - 2, 1, part)
            if first < last:
                fill_rows(gray, mean, blocks, copies, columns, first, last)
            finish(marks, 0)
    wait(marks, 0)


@njit()
def run_layers(isa, levels, layers, shares, zeros, scratch, edges, marks, who, threads):  # type: ignore[no-untyped-def]
    """Our share of the others.

    Args:
        isa: see `airline.network.processor`.
        levels, layers, scratch: see `airline.network.native.memory.Memory`.
        shares, zeros: see `airline.network.native.quantise.Quantised`.
        edges: (H, W) float32, which is filled.
        marks: see `airline.network.native.scheduler`.
        who, threads: which thread of how many.
    """
    count = len(levels)
    for phase in range(1, 2 * count):
        level = min(phase - 1, 2 * count - 1 - phase)
        unit = 2 if phase < count else 1  # pairs of rows make one of the next level
        for turn in range(marks.shape[1] - 1):
            part = next_part(marks, phase, turn, who, threads)
            if part < 0:
                continue
            first, last = bounds(marks, levels[level, ROWS], unit, part)
            if phase <= count:
                _down(isa, levels, layers, level, first, last)
            elif first < last:
                _up(isa, levels, layers, level, shares[level], zeros[level], first, last, scratch[who], edges)
            finish(marks, phase)
        wait(marks, phase)


@njit(inline="always")
def _down(isa, levels, layers, level, first, last):  # type: ignore[no-untyped-def]
    size = levels[level]
    stride, groups = size[STRIDE], size[GROUPS]
    apart = size[ROWS] * stride
    for y in range(first, last):
        target = size[DOWN] + y * stride
        source = size[INPUT] + y * stride
        if level:
            convolve(isa, BYTES, layers[level], 0, source, target, apart, size[COLUMNS])
        else:
            copies = size[COPIES] + y * stride
            convolve_first(isa, layers[0], layers[-1], source, copies, target, apart, size[COLUMNS])
        if level < len(levels) - 1 and y % 2:
            coarse = levels[level + 1]
            coarse_apart = (coarse[ROWS] + 2) * coarse[STRIDE]
            pooled = coarse[INPUT] + (y // 2 + 1) * coarse[STRIDE] + PIXEL
            pool_rows(isa, groups, target - stride, stride, apart, pooled, coarse_apart, coarse[COLUMNS])
            _fill_pixel(pooled + PIXEL * coarse[COLUMNS], coarse_apart, groups, 0)


@njit(inline="always")
def _up(isa, levels, layers, level, share, zero, first, last, scratch, edges):  # type: ignore[no-untyped-def]
    count = len(levels)
    size, coarse = levels[level], levels[level + 1]
    columns, stride, groups = size[COLUMNS], size[STRIDE], size[GROUPS]
    # three rows of sums, in turn; a row of what the coarser level adds; at the finest level a row of the last map and
    # one of logits
    sums, sums_apart = scratch.ctypes.data, 3 * stride
    added, added_apart = sums + groups * sums_apart, coarse[STRIDE]
    last_map = added + 4 * groups * added_apart
    logits = last_map + groups * stride
    lateral, up = layers[count + level], layers[2 * count + level]
    for y in range(first - 1, last + 1):
        row = sums + (y + 3) % 3 * stride + PIXEL
        if 0 <= y < size[ROWS]:
            if y % 2 == 0 or y == first - 1:
                source = coarse[UP] + y // 2 * coarse[STRIDE]
                convolve(isa, FLOATS, lateral, 0, source, added, added_apart, coarse[COLUMNS])
            fine = size[DOWN] + y * stride
            add_rows(isa, groups, fine, size[ROWS] * stride, share, added, added_apart, row, sums_apart, columns)
            _fill_pixel(row - PIXEL, sums_apart, groups, zero)
            _fill_pixel(row + PIXEL * columns, sums_apart, groups, zero)
        else:
            for x in range(-1, columns + 1):
                _fill_pixel(row + PIXEL * x, sums_apart, groups, zero)
        if y <= first:
            continue
        middle = y - 1
        above = (middle - 1) % 3
        if level:
            convolve(isa, BYTES, up, above, sums, size[UP] + middle * stride, size[ROWS] * stride, columns)
        else:
            convolve(isa, BYTES, up, above, sums, last_map, stride, columns)
            convolve(isa, LOGITS, layers[3 * count], 0, last_map, logits, stride, columns)
            place = logits - sums
            _write(scratch[place : place + 4 * stride].view(np.float32), middle, columns, edges)


@njit(inline="always")
def _fill_pixel(target, apart, groups, value):  # type: ignore[no-untyped-def]
    """Set all channels of a pixel."""
    for group in range(groups):
        fill(target + group * apart, value)


@njit(inline="always")
def _write(logits, y, columns, edges):  # type: ignore[no-untyped-def]
    """Two rows of the edge map, from four planes of one row: of left and right upper pixels, and of lower ones."""
    height, width = edges.shape
    stride = len(logits) // 4
    line = np.empty(2 * columns, np.float32)
    for dy in range(min(2, height - 2 * y)):
        left, right = logits[2 * dy * stride :], logits[(2 * dy + 1) * stride :]
        for x in range(columns):
            line[2 * x] = left[x]
            line[2 * x + 1] = right[x]
        _sigmoid(line)
        target = edges[2 * y + dy]
        for x in range(width):
            target[x] = line[x]


@njit(fastmath=True)
def _sigmoid(values):  # type: ignore[no-untyped-def]
    """Probabilities of logits, (N,) float32, in place."""
    for x in range(len(values)):
        t = HALF * values[x]
        t = LIMIT if t > LIMIT else (-LIMIT if t < -LIMIT else t)
        s = t * t
        over = A0 + s * (A1 + s * (A2 + s * (A3 + s)))
        values[x] = HALF + HALF * t * over / (A0 + s * (B1 + s * (B2 + s * (B3 + s * B4))))

"""The network from the image to the edge map, as phases of `airline.kernels.atomics`.

The first phase is the input; then comes a level after the other on the way down, each with the largest of each four
pixels for the next; then on the way up. Sources and targets are addresses; strides and what lies `apart` are in bytes.
"""

from __future__ import annotations

import numpy as np

from airline.kernels.atomics import bounds, finish, next_part, wait
from airline.kernels.compiled import njit
from airline.network.native.image import fill_rows
from airline.network.native.microkernels import BLOCK, BYTES, FLOATS, LOGITS, PIXEL, TILE, add_coarse, fill, pool, tile

# columns of the table of levels: rows and columns; from a row to the next, bytes; groups of channels; addresses of what
# its first layer takes, with a margin of a pixel, of the maps on the way down and up, and of smoothed copies
ROWS, COLUMNS, STRIDE, GROUPS, INPUT, DOWN, UP, COPIES = range(8)
# columns of the table of layers: addresses of weights, factors, offsets and terms; how many terms; how many blocks of
# outputs
WEIGHTS, FACTORS, OFFSETS, TERMS, COUNT, BLOCKS = range(6)

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
    """Our share of the others; fills `edges`, (H, W) float32.

    Args:
        isa: see `airline.network.runtimes`.
        levels, layers, scratch: see `airline.network.native.network.Memory`.
        shares, zeros: see `airline.network.native.quantise.Quantised`.
        marks: see `airline.kernels.atomics`.
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
    """Rows `first` to `last` of a level on the way down."""
    size = levels[level]
    stride, groups = size[STRIDE], size[GROUPS]
    apart = size[ROWS] * stride
    for y in range(first, last):
        target = size[DOWN] + y * stride
        source = size[INPUT] + y * stride
        if level:
            _convolve(isa, BYTES, layers[level], 0, source, target, apart, size[COLUMNS])
        else:
            copies = size[COPIES] + y * stride
            _convolve_first(isa, layers[0], layers[-1], source, copies, target, apart, size[COLUMNS])
        if level < len(levels) - 1 and y % 2:
            coarse = levels[level + 1]
            coarse_apart = (coarse[ROWS] + 2) * coarse[STRIDE]
            pooled = coarse[INPUT] + (y // 2 + 1) * coarse[STRIDE] + PIXEL
            for group in range(groups):
                for x in range(0, coarse[COLUMNS], TILE):
                    here = target - stride + group * apart + 2 * PIXEL * x
                    pool(isa, here, here + stride, pooled + group * coarse_apart + PIXEL * x)
            _fill_pixel(pooled + PIXEL * coarse[COLUMNS], coarse_apart, groups, 0)


@njit(inline="always")
def _up(isa, levels, layers, level, share, zero, first, last, scratch, edges):  # type: ignore[no-untyped-def]
    """Rows `first` to `last` of a level on the way up."""
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
                _convolve(isa, FLOATS, lateral, 0, source, added, added_apart, coarse[COLUMNS])
            for group in range(groups):
                for x in range(0, columns, TILE):
                    fine = size[DOWN] + y * stride + group * size[ROWS] * stride + PIXEL * x
                    there = added + 4 * group * added_apart + PIXEL * x // 2
                    add_coarse(isa, fine, share, there, added_apart, row + group * sums_apart + PIXEL * x)
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
            _convolve(isa, BYTES, up, above, sums, size[UP] + middle * stride, size[ROWS] * stride, columns)
        else:
            _convolve(isa, BYTES, up, above, sums, last_map, stride, columns)
            _convolve(isa, LOGITS, layers[3 * count], 0, last_map, logits, stride, columns)
            place = logits - sums
            _write(scratch[place : place + 4 * stride].view(np.float32), middle, columns, edges)


@njit()
def _convolve(isa, kind, layer, turn, source, target, apart, columns):  # type: ignore[no-untyped-def]
    """A row of a convolution.

    Args:
        kind: of answer, see `airline.network.native.microkernels`.
        layer: (6,) int64 row of the table.
        turn: which of the layer's lists of terms to take.
        source: what the terms are added to for the first pixel.
        target, apart: of the answer's first group, or plane of floats, and from it to the next.
        columns: how many pixels; what is written beyond them, up to the next whole tile, means nothing.
    """
    outputs = len(kind[0])
    planes = outputs // 4 if len(kind[1]) else outputs
    for block in range(layer[BLOCKS]):
        operands, offsets = _operands(layer, turn, block, outputs), layer[OFFSETS] + 4 * outputs * block
        out = target + planes * block * apart
        for x in range(0, columns, TILE):
            tile(isa, kind, operands, source + PIXEL * x, (), 0, offsets, out + PIXEL * x, apart)


@njit(inline="always")
def _convolve_first(isa, pixels, copies, source, copies_source, target, apart, columns):  # type: ignore[no-untyped-def]
    """A row of the first layer; rows of the table for pixels and for smoothed copies, the rest as for `_convolve`."""
    for block in range(pixels[BLOCKS]):
        of_bytes, of_words = _operands(pixels, 0, block, BLOCK), _operands(copies, 0, block, BLOCK)
        offsets, out = pixels[OFFSETS] + 4 * BLOCK * block, target + BLOCK // 4 * block * apart
        for x in range(0, columns, TILE):
            here, there = source + PIXEL * x, copies_source + PIXEL * x
            tile(isa, BYTES, of_bytes, here, of_words, there, offsets, out + PIXEL * x, apart)


@njit(inline="always")
def _operands(layer, turn, block, outputs):  # type: ignore[no-untyped-def]
    """What `tile` takes of a layer for a block of outputs."""
    count = layer[COUNT]
    weights = layer[WEIGHTS] + block * outputs * PIXEL * count
    return layer[TERMS] + 8 * turn * count, count, weights, layer[FACTORS] + 4 * outputs * block


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

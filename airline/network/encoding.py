"""The image as the edge network takes it, and its answer as an edge map: both in one pass over the pixels.

An image has few grey levels and bfloat16 few numbers, so most of both is looked up in tables.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.image import Gray
from airline.kernels.compiled import njit
from airline.kernels.threads import ALONE, ThreadTeam
from airline.network.sigmoid import sigmoid
from airline.network.smooth import box_mean
from airline.network.spec import UNetSpec

ONE = np.float32(1)
UPPER, ROUND, LAST = np.uint32(16), np.uint32(0x7FFF), np.uint32(1)
LEAST_ROWS = 64  # of the network's first level that are worth a thread

Codes = NDArray[np.uint16 | np.uint32]


def folded_size(spec: UNetSpec, height: int, width: int) -> tuple[int, int]:
    """Rows and columns of the network's first level for an image of a size, filled up to the network's stride."""
    rows, columns = (-(-side // spec.stride) * spec.stride // spec.unshuffle for side in (height, width))
    return rows, columns


def fold(gray: Gray, spec: UNetSpec, planes: Codes, team: ThreadTeam = ALONE) -> None:
    """Fill the network's input: normalised pixels of each block as channels, and smoothed copies.

    The same as `unet.normalise`, `pixel_unshuffle` and `UNet._smoothed` on an image whose last row and column
    are repeated up to the network's stride, with the channels last, as convolutions take them.

    Args:
        gray: the image.
        spec: shape of the network.
        planes: (rows, columns, C) of `folded_size`: uint16 for the bits of bfloat16, uint32 for those of float32, as
            numpy has no bfloat16.
        team: threads that share the work.
    """
    middle, deviation = (float(value[0, 0]) for value in cv2.meanStdDev(gray))
    mean, factor = np.float32(middle), np.float32(1 / max(deviation, 1.0))
    levels = (np.arange(np.iinfo(gray.dtype).max + 1, dtype=np.float32) - mean) * factor
    table = np.empty(len(levels), planes.dtype)
    _encode(levels.view(np.uint32), table)
    rows, columns, _ = planes.shape
    block = _unrolled(spec.unshuffle)
    reach = sum(range(spec.smoothed + 1))

    def fill(start: int, end: int) -> None:
        first, last = max(start - reach, 0), min(end + reach, rows)
        means = np.empty((last - first, columns), np.float32)
        _fold(gray, block, mean, factor, table, planes, means, first, start, end)
        for level in range(spec.smoothed):
            finer, means = means, np.empty_like(means)
            doubled = planes[start:end, :, len(block) ** 2 + level]
            box_mean(finer, level + 1, means)
            _encode_doubled(means[start - first : end - first], doubled)

    team.map_range(rows, LEAST_ROWS, fill)


def unfold(logits: Codes, side: int, height: int, width: int, team: ThreadTeam = ALONE) -> NDArray[np.float32]:
    """(height, width) float32 edge probability of (h, w, side * side) logits, in the codes of `fold`."""
    edges = np.empty((height, width), np.float32)
    numbers, table = (logits, _probabilities()) if logits.itemsize == 2 else (logits.view(np.float32), None)
    block, rows = _unrolled(side), -(-height // side)
    team.map_range(rows, LEAST_ROWS, lambda start, end: _unfold(numbers, block, table, edges, start, end))
    return edges


def _unrolled(count: int) -> tuple[int, ...]:
    """A tuple of a length: numba compiles for it, and so unrolls the loops that are as long."""
    return (0,) * count


@cache
def _probabilities() -> NDArray[np.float32]:
    """(65536,) float32 sigmoid of every bfloat16 number, by its code."""
    numbers = (np.arange(1 << 16, dtype=np.uint32) << UPPER).view(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # some are infinite, some no numbers
        return ONE / (ONE + np.exp(-numbers))


@njit(fastmath=True)
def _fold(
    gray: Any, block: Any, mean: Any, factor: Any, table: Any, planes: Any, means: Any, first: int, start: int, end: int
) -> None:
    """Rows from `start` to `end` of the planes, and the blocks' means of all rows from `first` on."""
    height, width = gray.shape
    columns = means.shape[1]
    side = len(block)
    lines = np.empty((side, side * columns), gray.dtype)
    share = ONE / np.float32(side * side)
    for y in range(first, first + len(means)):
        for dy in range(side):
            line = gray[min(side * y + dy, height - 1)]
            for x in range(width):
                lines[dy, x] = line[x]
            for x in range(width, side * columns):
                lines[dy, x] = line[width - 1]
        for x in range(columns if start <= y < end else 0):
            for dy in range(side):
                for dx in range(side):
                    planes[y, x, side * dy + dx] = table[lines[dy, side * x + dx]]
        for x in range(columns):
            total = np.int32(0)
            for dy in range(side):
                for dx in range(side):
                    total += lines[dy, side * x + dx]
            means[y - first, x] = (np.float32(total) * share - mean) * factor


@njit()
def _encode(bits: Any, codes: Any) -> None:
    """Bits of float32 numbers as codes; bfloat16 is their upper half, rounded to the nearest, ties to the even one."""
    if codes.itemsize == 2:
        for x in range(len(bits)):
            codes[x] = (bits[x] + ROUND + ((bits[x] >> UPPER) & LAST)) >> UPPER
    else:
        for x in range(len(bits)):
            codes[x] = bits[x]


@njit()
def _encode_doubled(means: Any, doubled: Any) -> None:
    """Twice each number as codes."""
    rows, columns = means.shape
    twice, codes = np.empty(columns, np.float32), np.empty(columns, doubled.dtype)
    for y in range(rows):
        for x in range(columns):
            twice[x] = means[y, x] + means[y, x]
        _encode(twice.view(np.uint32), codes)
        for x in range(columns):
            doubled[y, x] = codes[x]


@njit()
def _unfold(numbers: Any, block: Any, table: Any, edges: Any, start: int, end: int) -> None:
    """`table` has the probability of each number; None where they are float32."""
    height, width = edges.shape
    side = len(block)
    columns = (width + side - 1) // side
    lines = np.empty((side, side * columns), np.float32)
    for y in range(start, end):
        for x in range(columns):
            for dy in range(side):
                for dx in range(side):
                    number = numbers[y, x, side * dy + dx]
                    lines[dy, side * x + dx] = number if table is None else table[number]
        for dy in range(min(side, height - side * y)):
            if table is None:
                sigmoid(lines[dy])
            for x in range(width):
                edges[side * y + dy, x] = lines[dy, x]

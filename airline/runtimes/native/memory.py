"""Where the maps of the network lie, for one size of image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.runtimes.native.quantise import Layer, Quantised
from airline.runtimes.native.rows import PIXEL
from airline.runtimes.native.vectors import TILE

Terms = list[list[int]]


@dataclass(frozen=True)
class Memory:
    """Maps, and the tables that tell the compiled code where all is.

    Attributes:
        planes: (groups, rows + 2, stride, 2) int16, the input.
        first: (outputs,) float32, factors of the first layer, which depend on the image.
        levels: (levels, 7) int64, see `airline.runtimes.native.phases`.
        layers: (3 levels + 1, 7) int64, see `airline.runtimes.native.rows`: those on the way down, the lateral ones,
            those on the way up, the head.
        scratch: (threads, bytes) uint8.
        kept: what the tables have the addresses of.
    """

    planes: NDArray[np.int16]
    first: NDArray[np.float32]
    levels: NDArray[np.int64]
    layers: NDArray[np.int64]
    scratch: NDArray[np.uint8]
    kept: list[NDArray[Any]]


def lay_out(quantised: Quantised, rows: int, columns: int, threads: int) -> Memory:
    """Memory for a network.

    Args:
        quantised: its layers.
        rows, columns: of the finest level; multiples of 2 to the number of coarser ones.
        threads: how many work on it.
    """
    kept: list[NDArray[Any]] = []

    def address(array: NDArray[Any]) -> int:
        kept.append(array)
        return array.ctypes.data

    count = len(quantised.down)
    # whole tiles, another one that is read beyond them, and the margin
    widths = [columns >> level for level in range(count)]
    strides = [PIXEL * TILE * (-(-width // TILE) + 2) for width in widths]
    groups = [2 * len(layer.weights) for layer in quantised.down]
    levels = np.zeros((count, 7), np.int64)
    for level, (width, stride) in enumerate(zip(widths, strides, strict=True)):
        high = rows >> level
        taken_groups = groups[level - 1] if level else quantised.down[0].weights.shape[1]
        taken = np.zeros((taken_groups, high + 2, stride), np.uint8)
        if level == 0:
            planes = taken.view(np.int16).reshape(*taken.shape[:2], -1, 2)
        down = np.zeros((groups[level], high, stride), np.uint8)
        up = np.zeros_like(down) if 0 < level < count - 1 else down
        levels[level] = high, width, stride, groups[level], address(taken), address(down), address(up)

    first = np.empty_like(quantised.down[0].factors)
    layers = np.zeros((3 * count + 1, 7), np.int64)

    def put(place: int, layer: Layer, terms: Terms) -> None:
        factors = first if place == 0 else layer.factors
        addresses = [address(array) for array in (layer.weights, factors, layer.offsets, np.array(terms, np.int64))]
        layers[place] = *addresses, len(terms[0]), len(layer.weights), layer.weights.dtype == np.int16

    for level, layer in enumerate(quantised.down):
        put(level, layer, [_square(layer, ((rows >> level) + 2) * strides[level], strides[level], (0, 1, 2))])
    for level, layer in enumerate(quantised.lateral):
        put(count + level, layer, [_point(layer, (rows >> (level + 1)) * strides[level + 1])])
    for level, layer in enumerate(quantised.up):
        turns = [tuple((turn + dy) % 3 for dy in range(3)) for turn in range(3)]
        put(2 * count + level, layer, [_square(layer, 3 * strides[level], strides[level], turn) for turn in turns])
    put(3 * count, quantised.head, [_point(quantised.head, strides[0])])
    needed = [groups[level] * 4 * (strides[level] + strides[level + 1]) for level in range(count - 1)]
    scratch = np.zeros((threads, max(needed) + 4 * strides[0]), np.uint8)
    return Memory(planes, first, levels, layers, scratch, kept)


def _square(layer: Layer, apart: int, stride: int, rows: tuple[int, ...]) -> list[int]:
    """Terms of a 3x3 convolution of groups that lie apart, from the pixel above and to the left of the one in question.

    `rows` has the number of each of the three rows.
    """
    places = [stride * row + PIXEL * dx for row in rows for dx in range(3)]
    return [group * apart + place for group in range(layer.weights.shape[1]) for place in places]


def _point(layer: Layer, apart: int) -> list[int]:
    """Terms of a 1x1 convolution."""
    return [group * apart for group in range(layer.weights.shape[1])]

"""Where the maps of the network lie, for one size of image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.network.native.microkernels import PIXEL
from airline.network.native.quantise import Layer, Quantised
from airline.network.native.vectors import TILE


@dataclass(frozen=True)
class Memory:
    """Maps, and the tables that tell the compiled code where all is.

    Attributes:
        blocks: (rows + 2, stride) uint32, see `fill_rows`.
        copies: (groups, rows + 2, stride, 2) int16, see there.
        pixels: the first layer, whose factors and offsets depend on the image.
        smoothed: its share of smoothed copies, whose factors do.
        levels: (levels, 8) int64, see `airline.network.native.forward`.
        layers: (3 levels + 2, 6) int64, see there: those on the way down, the lateral ones, those on the way up, the
            head, the first one's share of smoothed copies.
        scratch: (threads, bytes) uint8.
        kept: what the tables have the addresses of.
    """

    blocks: NDArray[np.uint32]
    copies: NDArray[np.int16]
    pixels: Layer
    smoothed: Layer
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
    levels = np.zeros((count, 8), np.int64)
    for level, (width, stride) in enumerate(zip(widths, strides, strict=True)):
        high = rows >> level
        taken = _room((groups[level - 1] if level else 1, high + 2, stride))
        if level == 0:
            blocks = taken[0].view(np.uint32)
            copies = _room((quantised.copies.weights.shape[1], *blocks.shape, PIXEL)).view(np.int16)
        down = _room((groups[level], high, stride))
        up = _room(down.shape) if 0 < level < count - 1 else down
        levels[level] = high, width, stride, groups[level], address(taken), address(down), address(up), address(copies)

    layers = np.zeros((3 * count + 2, 6), np.int64)

    def put(place: int, layer: Layer, terms: list[list[int]]) -> None:
        arrays = (layer.weights, layer.factors, layer.offsets, np.array(terms, np.int64))
        layers[place] = *(address(array) for array in arrays), len(terms[0]), len(layer.weights)

    pixels, smoothed = (  # with factors and offsets of this size's own
        Layer(layer.weights, layer.factors.copy(), layer.offsets.copy())
        for layer in (quantised.down[0], quantised.copies)
    )
    for level, layer in enumerate([pixels, *quantised.down[1:]]):
        put(level, layer, [_square(layer, ((rows >> level) + 2) * strides[level], strides[level], (0, 1, 2))])
    for level, layer in enumerate(quantised.lateral):
        put(count + level, layer, [_point(layer, (rows >> (level + 1)) * strides[level + 1])])
    for level, layer in enumerate(quantised.up):
        turns = [tuple((turn + dy) % 3 for dy in range(3)) for turn in range(3)]
        put(2 * count + level, layer, [_square(layer, 3 * strides[level], strides[level], turn) for turn in turns])
    put(3 * count, quantised.head, [_point(quantised.head, strides[0])])
    put(3 * count + 1, smoothed, [_square(smoothed, (rows + 2) * strides[0], strides[0], (0, 1, 2))])
    needed = [groups[level] * 4 * (strides[level] + strides[level + 1]) for level in range(count - 1)]
    scratch = _room((threads, max(needed) + 4 * strides[0]))
    return Memory(blocks, copies, pixels, smoothed, levels, layers, scratch, kept)


def _room(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    return np.zeros(shape, np.uint8)


def _square(layer: Layer, apart: int, stride: int, rows: tuple[int, ...]) -> list[int]:
    """Terms of a 3x3 convolution over three rows of these numbers, from the pixel above and to the left."""
    places = [stride * row + PIXEL * dx for row in rows for dx in range(3)]
    return [group * apart + place for group in range(layer.weights.shape[1]) for place in places]


def _point(layer: Layer, apart: int) -> list[int]:
    """Terms of a 1x1 convolution."""
    return [group * apart for group in range(layer.weights.shape[1])]

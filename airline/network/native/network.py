"""The runtime "native"."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.image import Gray, mean_and_deviation
from airline.kernels.threads import ThreadTeam
from airline.network.native.forward import COLUMNS, run_layers, take_image
from airline.network.native.image import GAIN
from airline.network.native.microkernels import PIXEL, TILE
from airline.network.native.quantise import Layer, Quantised, quantise
from airline.network.runtimes import vector_instructions
from airline.network.spec import SIZES, UNetSpec
from airline.network.weights import load_ranges, load_weights

FARTHEST = 5.0  # deviations from the mean that an image of 16 bits keeps
PARTS = 8  # of a phase: few enough to be worth a step, enough for threads that do not start together


@dataclass(frozen=True)
class Memory:
    """Where the maps lie for one size of image, and the tables that tell the compiled code.

    Attributes:
        blocks, copies: see `fill_rows`.
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
    """Memory for a network whose finest level has such rows and columns, and for so many threads."""
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


class NativeNetwork:
    """A U-Net in 8-bit numbers, but for smoothed copies of the image, which are 16-bit numbers; see `EdgeNetwork`.

    Images of 16 bits become ones of 8. Raises WeightsError, and ConfigError where the processor lacks the instructions
    or the network is of another kind.
    """

    name = "native int8"

    def __init__(self, weights: str | Path, threads: int | None = None) -> None:
        isa = vector_instructions()
        if isa is None:
            raise ConfigError("this processor lacks AVX2, which the runtime native needs: use --runtime auto")
        self._isa = isa
        self._spec, tensors = load_weights(weights)
        ranges = load_ranges(weights)
        if not ranges or not _fits(self._spec):
            raise ConfigError(f"the network {weights} cannot run in 8-bit numbers: use --runtime auto")
        self._quantised = quantise(self._spec, tensors, ranges, 127 if isa[1] else 63)
        self._sums = self._quantised.down[0].weights.sum(axis=(1, 2, 4), dtype=np.float32).ravel()
        self._team = ThreadTeam(threads)
        self._memory_for = lru_cache(SIZES)(self._memory)
        self._lock = threading.Lock()

    def __call__(self, gray: Gray) -> NDArray[np.float32]:
        image = _narrow(gray)
        mean, deviation = mean_and_deviation(image)
        edges = np.empty(image.shape, np.float32)
        marks = np.zeros((2 * self._spec.levels, PARTS + 1), np.int32)
        threads = self._team.threads
        with self._lock:
            memory = self._memory_for(*image.shape)
            self._normalise(memory, mean, max(deviation, 1.0))
            tables = memory.levels, memory.layers, self._quantised.shares, self._quantised.zeros

            def take_part(start: int, end: int) -> None:
                for who in range(start, end):
                    columns = memory.levels[0, COLUMNS]
                    take_image(image, np.float32(mean), memory.blocks, memory.copies, columns, marks, who, threads)
                    run_layers(self._isa, *tables, memory.scratch, edges, marks, who, threads)

            self._team.map_range(threads, 1, take_part)
        return edges

    def _normalise(self, memory: Memory, mean: float, deviation: float) -> None:
        """Make the first layer one for images of this mean and deviation."""
        layer = self._quantised.down[0]
        np.divide(layer.factors, deviation, out=memory.pixels.factors)
        np.subtract(layer.offsets, memory.pixels.factors * mean * self._sums, out=memory.pixels.offsets)
        np.divide(self._quantised.copies.factors, deviation * GAIN, out=memory.smoothed.factors)

    def _memory(self, height: int, width: int) -> Memory:
        return lay_out(self._quantised, *self._spec.folded_size(height, width), self._team.threads)


def suits(weights: str | Path) -> bool:
    """Whether this runtime is the best for this processor and these weights; errors of `NativeNetwork`."""
    return vector_instructions() is not None and bool(load_ranges(weights)) and _fits(load_weights(weights)[0])


def _fits(spec: UNetSpec) -> bool:
    """Whether a network is of the kind that this runtime is made for."""
    return spec.unshuffle == 2 and spec.convs == 1 and spec.levels > 1


def _narrow(gray: Gray) -> NDArray[np.uint8]:
    """An image in 8 bits; what is more than `FARTHEST` deviations from its mean may be cut off."""
    if gray.dtype == np.uint8:
        return np.ascontiguousarray(gray, np.uint8)
    mean, deviation = mean_and_deviation(gray)
    least = max(float(gray.min()), mean - FARTHEST * deviation)
    most = min(float(gray.max()), mean + FARTHEST * deviation)
    stretched = (gray - np.float32(least)) * np.float32(255 / max(most - least, 1.0))
    narrow: NDArray[np.uint8] = np.rint(np.clip(stretched, 0, 255)).astype(np.uint8)
    return narrow

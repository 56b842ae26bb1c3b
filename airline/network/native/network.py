"""The runtime "native"."""

from __future__ import annotations

import threading
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.image import Gray, mean_and_deviation
from airline.kernels.threads import ThreadTeam
from airline.network.native.forward import COLUMNS, run_layers, take_image
from airline.network.native.image import GAIN
from airline.network.native.memory import Memory, lay_out
from airline.network.native.quantise import quantise
from airline.network.processor import vector_instructions
from airline.network.spec import SIZES, UNetSpec
from airline.network.weights import load_ranges, load_weights

FARTHEST = 5.0  # deviations from the mean that an image of 16 bits keeps
PARTS = 8  # of a phase: few enough to be worth a step, enough for threads that do not start together


class NativeNetwork:
    """A U-Net in 8-bit numbers, but for smoothed copies of the image, which are 16-bit numbers; see `EdgeNetwork`.

    Images of 16 bits become ones of 8, where 255 grey levels are ten standard deviations at most.

    Raises:
        WeightsError: the weights cannot be used.
        ConfigError: the processor lacks the instructions, or the network is of another kind.
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

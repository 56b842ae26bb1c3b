"""The network's weights as whole numbers, in the order in which the SIMD code takes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airline.network.native.microkernels import BLOCK
from airline.network.spec import UNetSpec
from airline.network.weights import Ranges

LEAST = 1e-9  # a range must not be empty, as that of a map of zeros would be
MOST = 255  # in a map
ROUNDING = 0.5  # added to answers, which are then cut off
LARGEST = 32_767  # 16-bit number
WORDS = 65_000  # sum of a channel's 16-bit weights: with any 16-bit input the products add up to less than 2 ** 31


@dataclass(frozen=True)
class Layer:
    """A convolution in whole numbers: `factor * (sum of products) + offset` is what the next layer takes.

    Attributes:
        weights: (outputs / block, groups, taps, block, per group) int8 or int16.
        factors, offsets: (outputs,) float32.
    """

    weights: NDArray[np.int8 | np.int16]
    factors: NDArray[np.float32]
    offsets: NDArray[np.float32]


@dataclass(frozen=True)
class Quantised:
    """All layers.

    Attributes:
        down, lateral, up, head: as in `UNet`; `down[0]` takes no smoothed copies, and images of mean 0 and deviation 1.
        copies: the first layer's share of smoothed copies, which are 16-bit numbers.
        shares: (levels - 1,) float32 what 1 in a level's map counts in the sum with the coarser one.
        zeros: (levels - 1,) int64 the number that stands for zero in the sum.
    """

    down: list[Layer]
    lateral: list[Layer]
    up: list[Layer]
    head: Layer
    copies: Layer
    shares: NDArray[np.float32]
    zeros: NDArray[np.int64]


def quantise(spec: UNetSpec, weights: Mapping[str, NDArray[np.float32]], ranges: Ranges, largest: int) -> Quantised:
    """Whole numbers for a network.

    Args:
        spec, weights, ranges: see `airline.network.weights`.
        largest: of the 8-bit weights, at most 127.
    """
    first, pixels, last = weights["down.0.0.weight"], spec.unshuffle**2, spec.levels - 1
    layers = _Layers({**weights, "down.0.0.weight": first[:, :pixels]}, largest)
    # what 1 in each map stands for: on the way down, and, from the next but one layer's point of view, on the way up
    units = [_unit(0, ranges[f"down.{level + 1}.0"][1]) for level in range(last)]
    units.append(_unit(0, ranges[f"lateral.{last - 1}"][1]))
    up_units = [_unit(0, ranges["head" if level == 0 else f"lateral.{level - 1}"][1]) for level in range(last)]
    up_units.append(units[last])
    down = [layers.of_bytes("down.0.0", 1.0, units[0])]
    down += [layers.of_bytes(f"down.{level + 1}.0", units[level], units[level + 1]) for level in range(last)]
    lateral, up, shares, zeros = [], [], [], []
    for level in range(last):
        low, high = ranges[f"up.{level}.0"]
        unit = _unit(low, high)
        zero = round(max(-low, 0) / unit)
        lateral.append(layers.of_bytes(f"lateral.{level}", up_units[level + 1], unit, answer_zero=zero))
        up.append(layers.of_bytes(f"up.{level}.0", unit, up_units[level], zero))
        shares.append(units[level] / unit)
        zeros.append(zero)
    head = layers.of_bytes("head", up_units[0], 1.0, answer_zero=-ROUNDING, block=4)
    copies = _of_words(first[:, pixels:], units[0])
    return Quantised(down, lateral, up, head, copies, np.array(shares, np.float32), np.array(zeros, np.int64))


def _unit(low: float, high: float) -> float:
    """What 1 stands for in a map of numbers from `low` to `high`, of which 0 is one."""
    return (max(high, LEAST) - min(low, 0)) / MOST


@dataclass(frozen=True)
class _Layers:
    """Makes whole numbers of a network's weights."""

    weights: Mapping[str, NDArray[np.float32]]
    largest: int

    def of_bytes(
        self, name: str, unit: float, answer: float, zero: int = 0, answer_zero: float = 0, block: int = BLOCK
    ) -> Layer:
        """A layer of 8-bit numbers, `block` channels of which are answered at once.

        `unit` and `zero`: what 1 of its input stands for, and which input stands for zero; `answer...`: of its output.
        """
        kernel, bias = self.weights[f"{name}.weight"], self.weights[f"{name}.bias"]
        steps = np.maximum(np.abs(kernel).max(axis=(1, 2, 3)), LEAST) / self.largest
        whole = np.rint(kernel / steps[:, None, None, None]).astype(np.int8)
        factors = steps * unit / answer
        offsets = bias / answer - factors * zero * whole.sum(axis=(1, 2, 3), dtype=np.int64) + answer_zero + ROUNDING
        return Layer(_arranged(whole, block, 4), _filled(factors, block), _filled(offsets, block))


def _of_words(kernel: NDArray[np.float32], answer: float) -> Layer:
    """A layer of 16-bit numbers, without a bias, of copies that are half of what the network takes."""
    doubled = 2 * kernel.astype(np.float64)
    sizes = np.abs(doubled).reshape(len(doubled), -1)
    most = sizes.max(axis=1, initial=0)
    steps = np.maximum(np.maximum(sizes.sum(axis=1) / WORDS, most / LARGEST), LEAST)
    whole = np.rint(doubled / steps[:, None, None, None]).astype(np.int16)
    return Layer(_arranged(whole, BLOCK, 2), _filled(steps / answer, BLOCK), _filled(0 * steps, BLOCK))


def _arranged(kernel: NDArray[np.int8 | np.int16], block: int, group: int) -> NDArray[np.int8 | np.int16]:
    """(O / block, I / group, taps, block, group) of an (O, I, h, w) kernel, filled up with zeros."""
    outputs, inputs, height, width = kernel.shape
    blocks, groups = -(-outputs // block), -(-inputs // group)
    full = np.zeros((blocks * block, groups * group, height, width), kernel.dtype)
    full[:outputs, :inputs] = kernel
    apart = full.reshape(blocks, block, groups, group, height * width)
    return np.ascontiguousarray(apart.transpose(0, 2, 4, 1, 3))


def _filled(values: NDArray[np.floating], block: int) -> NDArray[np.float32]:
    """(O,) numbers, zeros after them for channels that are not there."""
    return np.pad(values, (0, -len(values) % block)).astype(np.float32)

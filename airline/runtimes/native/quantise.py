"""The network's weights as whole numbers, in the order in which the vector code takes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airline.runtimes.native.rows import BLOCK
from airline.spec import UNetSpec
from airline.weights import Ranges

LEAST = 1e-9  # a range must not be empty, as that of a map of zeros would be
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
        down, lateral, up, head: as in `airline.unet.UNet`; `down[0]` takes 16-bit numbers, and its factors are to be
            multiplied with what one of them stands for.
        shares: per level with a coarser one, what 1 in its map counts in the sum; float32.
        zeros: per such level, the number that stands for zero in the sum; int64.
    """

    down: list[Layer]
    lateral: list[Layer]
    up: list[Layer]
    head: Layer
    shares: NDArray[np.float32]
    zeros: NDArray[np.int64]


def quantise(spec: UNetSpec, weights: Mapping[str, NDArray[np.float32]], ranges: Ranges, most: int) -> Quantised:
    """Whole numbers for a network.

    Args:
        spec, weights: see `airline.weights.load_weights`.
        ranges: see `airline.weights.load_ranges`.
        most: the largest number of a map, 255 or 127.
    """
    last = spec.levels - 1
    units = [_high(ranges[f"down.{level + 1}.0"]) / most for level in range(last)]  # of the maps on the way down
    units.append(_high(ranges[f"lateral.{last - 1}"]) / most)
    up_units = [_high(ranges["head" if level == 0 else f"lateral.{level - 1}"]) / most for level in range(last)]
    up_units.append(units[last])
    down = [_words(weights, "down.0.0", spec.unshuffle**2, units[0])]
    down += [_bytes(weights, f"down.{k + 1}.0", units[k], 0, units[k + 1]) for k in range(last)]
    lateral, up, shares, zeros = [], [], [], []
    for level in range(last):
        low, high = ranges[f"up.{level}.0"]
        low, high = min(low, 0.0), max(high, LEAST)
        unit = (high - low) / most
        zero = round(-low / unit)
        coarse = _bytes(weights, f"lateral.{level}", up_units[level + 1], 0, unit)
        lateral.append(Layer(coarse.weights, coarse.factors, coarse.offsets + np.float32(zero)))
        up.append(_bytes(weights, f"up.{level}.0", unit, zero, up_units[level]))
        shares.append(units[level] / unit)
        zeros.append(zero)
    head = _bytes(weights, "head", up_units[0], 0, 1.0, block=4, rounding=0.0)
    return Quantised(down, lateral, up, head, np.array(shares, np.float32), np.array(zeros, np.int64))


def _high(ends: tuple[float, float]) -> float:
    return max(ends[1], LEAST)


def _bytes(
    weights: Mapping[str, NDArray[np.float32]],
    name: str,
    unit: float,
    zero: int,
    answer: float,
    block: int = BLOCK,
    rounding: float = 0.5,
) -> Layer:
    """A layer of 8-bit numbers.

    Args:
        weights: of all layers.
        name: of this one.
        unit: what 1 of the input stands for.
        zero: the input that stands for zero.
        answer: what 1 of the output stands for.
        block: channels that are answered at once.
        rounding: added to answers, which are then cut off.
    """
    kernel, bias = weights[f"{name}.weight"], weights[f"{name}.bias"]
    steps = np.maximum(np.abs(kernel).max(axis=(1, 2, 3)), LEAST) / 127
    whole = np.rint(kernel / steps[:, None, None, None]).astype(np.int8)
    factors = steps * unit / answer
    offsets = bias / answer - factors * zero * whole.sum(axis=(1, 2, 3), dtype=np.int64) + rounding
    return Layer(_arranged(whole, block, 4), _filled(factors, block), _filled(offsets, block))


def _words(weights: Mapping[str, NDArray[np.float32]], name: str, pixels: int, answer: float) -> Layer:
    """The first layer; inputs from `pixels` on are smoothed copies, of which the network takes the double."""
    kernel, bias = weights[f"{name}.weight"].astype(np.float64), weights[f"{name}.bias"]
    kernel[:, pixels:] *= 2
    steps = np.maximum(np.abs(kernel).sum(axis=(1, 2, 3)) / WORDS, np.abs(kernel).max(axis=(1, 2, 3)) / LARGEST)
    steps = np.maximum(steps, LEAST)
    whole = np.rint(kernel / steps[:, None, None, None]).astype(np.int16)
    return Layer(_arranged(whole, BLOCK, 2), _filled(steps / answer, BLOCK), _filled(bias / answer + 0.5, BLOCK))


def _arranged(kernel: NDArray[np.int8 | np.int16], block: int, group: int) -> NDArray[np.int8 | np.int16]:
    """(O / block, I / group, taps, block, group) of an (O, I, h, w) kernel, filled up with zeros."""
    outputs, inputs, height, width = kernel.shape
    blocks, groups = -(-outputs // block), -(-inputs // group)
    full = np.zeros((blocks * block, groups * group, height * width), kernel.dtype)
    full[:outputs, :inputs] = kernel.reshape(outputs, inputs, -1)
    return np.ascontiguousarray(full.reshape(blocks, block, groups, group, -1).transpose(0, 2, 4, 1, 3))


def _filled(values: NDArray[np.floating], block: int) -> NDArray[np.float32]:
    """(O,) numbers, zeros after them for channels that are not there."""
    return np.pad(values, (0, -len(values) % block)).astype(np.float32)

"""The edge network as an OpenVINO graph, built from its weights without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import openvino as ov
from numpy.typing import NDArray
from openvino import opset13 as op

from airline.network.spec import UNetSpec
from airline.network.weights import Ranges

Weights = Mapping[str, NDArray[np.float32]]

LEAST = 1e-9  # a range must not be empty, as that of a map of zeros would be


def build(
    spec: UNetSpec,
    weights: Weights,
    rows: int,
    columns: int,
    codes: ov.Type = ov.Type.f32,
    pairs: bool = False,
    ranges: Ranges | None = None,
) -> ov.Model:
    """The layers of `airline.network.unet.UNet` for one image size.

    What comes before and after them is `airline.network.encoding`: as graph nodes it took longer than the convolutions.

    Args:
        spec, weights: see `airline.network.weights.load_weights`.
        rows, columns: of the first level.
        codes: numbers of input and output, float32 or bfloat16.
        pairs: convolve the last map two pixels at a time, as if it had half the columns and twice the channels: half
            of the weights are zeros then, but where there are matrix units, which so few channels do not fill, that
            is faster. Columns must be even.
        ranges: of the inputs of all convolutions but the first; with them these work in 8-bit numbers.

    Returns:
        A model from (1, rows, columns, C) channels to (1, rows, columns, unshuffle * unshuffle) logits. The channels
        are last, and the numbers those of the convolutions, so that neither needs a pass over the image.
    """
    layers = _Layers(spec, weights, ranges)
    planes = op.parameter([1, rows, columns, spec.unshuffle**2 + spec.smoothed], codes, name="planes")
    x: ov.Node = _channels_second(op.convert(planes, np.float32))
    skips = []
    for level in range(spec.levels):
        if level:
            x = op.max_pool(x, [2, 2], [1, 1], [0, 0], [0, 0], [2, 2]).output(0)
            x = layers.narrowed(x, f"down.{level}.0")
        x = layers.block(x, f"down.{level}")
        skips.append(x)
    run = 1
    for level in reversed(range(spec.levels - 1)):
        size = rows >> level, columns >> level, spec.widths[level]
        run = 2 if pairs and level == 0 else 1
        x = layers.add_coarse(skips[level], x, level, size, run)
        x = layers.block(x, f"up.{level}", run)
    logits = _channels_last(layers.conv(layers.narrowed(x, "head"), "head", run))
    logits = op.reshape(logits, [1, rows, columns, spec.unshuffle**2], special_zero=False)
    return ov.Model([op.convert(logits, codes)], [planes], "edges")


@dataclass(frozen=True)
class _Layers:
    """Makes parts of the graph; in 8-bit numbers where there are ranges."""

    spec: UNetSpec
    weights: Weights
    ranges: Ranges | None

    def block(self, x: ov.Node, name: str, run: int = 1) -> ov.Node:
        for index in range(self.spec.convs):
            conv = f"{name}.{2 * index}"
            x = op.relu(self.conv(self.narrowed(x, conv) if index else x, conv, run))
        return x

    def conv(self, x: ov.Node, name: str, run: int = 1, copies: int = 1) -> ov.Node:
        """A convolution of a map with `run` pixels of a row as one, answering each channel `copies` times."""
        kernel: Any = np.tile(_for_runs(self.weights[f"{name}.weight"], run), (copies, 1, 1, 1))
        bias = np.tile(self.weights[f"{name}.bias"], run * copies).reshape(1, -1, 1, 1)
        margin = [side // 2 for side in kernel.shape[2:]]
        if self.ranges and name in self.ranges:
            reach = np.maximum(np.abs(kernel).max(axis=(1, 2, 3), keepdims=True), LEAST)
            kernel = op.fake_quantize(op.constant(kernel), -reach, reach, -reach, reach, 255)
        return op.add(op.convolution(x, kernel, [1, 1], margin, margin, [1, 1]), bias)

    def narrowed(self, x: ov.Node, conv: str) -> ov.Node:
        """A map in 8-bit numbers, as the convolution that takes it needs it."""
        if not self.ranges:
            return x
        low, high = self.ranges[conv]
        if low < 0:
            reach = max(-low, high)
            low, high = -reach, reach * 127 / 128
        ends = np.float32(min(low, 0)), np.float32(max(high, LEAST))
        return op.fake_quantize(x, *ends, *ends, 256)

    def add_coarse(self, fine: ov.Node, coarse: ov.Node, level: int, size: tuple[int, int, int], run: int) -> ov.Node:
        """A level's map plus the coarser one, each pixel of which counts for four, with `run` pixels of a row as one.

        The coarse map gets its channels twice, which with the channels last is each pixel twice, and is broadcast over
        two rows, so that the enlarged map is never written.
        """
        rows, columns, channels = size
        coarse = self.conv(self.narrowed(coarse, f"lateral.{level}"), f"lateral.{level}", copies=2)
        fine = op.reshape(_channels_last(fine), [1, rows // 2, 2, columns * channels], special_zero=False)
        coarse = op.reshape(_channels_last(coarse), [1, rows // 2, 1, columns * channels], special_zero=False)
        total = self.narrowed(op.add(fine, coarse), f"up.{level}.0")
        total = op.reshape(total, [1, rows, columns // run, channels * run], special_zero=False)
        return _channels_second(total)


def _for_runs(kernel: NDArray[np.float32], run: int) -> NDArray[np.float32]:
    """(run * O, run * I, h, w) kernel that does to runs of pixels what an (O, I, h, w) one does to single pixels.

    `w` is at most 3; the channels of a run are those of its first pixel, then those of the next.
    """
    outputs, inputs, height, width = kernel.shape
    wide = np.zeros((run, outputs, run, inputs, height, width), np.float32)
    for pixel in range(run):
        for tap in range(width):
            block, source = divmod(pixel + tap - width // 2, run)
            wide[pixel, :, source, :, :, block + width // 2] = kernel[..., tap]
    return wide.reshape(run * outputs, run * inputs, height, width)


def _channels_last(x: ov.Node) -> ov.Node:
    return op.transpose(x, np.array([0, 2, 3, 1]))


def _channels_second(x: ov.Node) -> ov.Node:
    return op.transpose(x, np.array([0, 3, 1, 2]))

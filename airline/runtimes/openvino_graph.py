"""The edge network as an OpenVINO graph, built from its weights without torch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import openvino as ov
from numpy.typing import DTypeLike, NDArray
from openvino import opset13 as op

from airline.spec import UNetSpec

Weights = Mapping[str, NDArray[np.float32]]


def build(spec: UNetSpec, weights: Weights, height: int, width: int, depth: DTypeLike) -> ov.Model:
    """The network of `airline.unet.UNet.answer` for one image size, its sigmoid included.

    Args:
        spec, weights: see `airline.weights.load_weights`.
        height, width: of the image, px.
        depth: uint8, or float32.

    Returns:
        A model with the inputs `gray` (1, 1, height, width) of that depth and `scale` (3,) float32, whose values make
        the grey levels g into the network's input (g - scale[0]) * scale[1] + scale[2]; its output is (height, width)
        float32 edge probability.
    """
    gray = op.parameter([1, 1, height, width], depth, name="gray")
    scale = op.parameter([3], np.float32, name="scale")
    middle, factor, rest = op.split(scale, 0, 3).outputs()
    x = op.add(op.multiply(op.subtract(op.convert(gray, np.float32), middle), factor), rest)
    beyond = [0, 0, -height % spec.stride, -width % spec.stride]
    if any(beyond):
        x = op.pad(x, [0, 0, 0, 0], beyond, "edge")
    logits = _logits(x, spec, weights)
    if any(beyond):
        logits = op.slice(logits, [0, 0], [height, width], [1, 1], [2, 3])
    edges = op.reshape(op.sigmoid(logits), [height, width], special_zero=False)
    return ov.Model([edges], [gray, scale], "edges")


def _logits(x: ov.Node, spec: UNetSpec, weights: Weights) -> ov.Node:
    x = op.space_to_depth(x, "blocks_first", spec.unshuffle)
    if spec.smoothed:
        x = op.concat([x, *_smoothed(x, spec.smoothed)], 1)
    skips = []
    for level in range(spec.levels):
        if level:
            x = op.max_pool(x, [2, 2], [1, 1], [0, 0], [0, 0], [2, 2]).output(0)
        x = _block(x, f"down.{level}", spec, weights)
        skips.append(x)
    for level in reversed(range(spec.levels - 1)):
        x = op.interpolate(
            _conv(x, f"lateral.{level}", weights),
            np.array([2, 2], np.float32),
            "nearest",
            "scales",
            coordinate_transformation_mode="asymmetric",
            nearest_mode="floor",
            axes=np.array([2, 3]),
        )
        x = _block(op.add(x, skips[level]), f"up.{level}", spec, weights)
    return op.depth_to_space(_conv(x, "head", weights), "blocks_first", spec.unshuffle)


def _smoothed(x: ov.Node, count: int) -> list[ov.Node]:
    """See `UNet._smoothed`; a square mean is the mean of the rows' means, also at the border."""
    copies = [op.reduce_mean(x, [1], keep_dims=True)]
    for radius in range(1, count + 1):
        row = op.avg_pool(copies[-1], [1, 1], [0, radius], [0, radius], [1, 2 * radius + 1], True)
        copies.append(op.avg_pool(row, [1, 1], [radius, 0], [radius, 0], [2 * radius + 1, 1], True))
    return [op.multiply(copy, np.float32(2)) for copy in copies[1:]]


def _block(x: ov.Node, name: str, spec: UNetSpec, weights: Weights) -> ov.Node:
    for conv in range(spec.convs):
        x = op.relu(_conv(x, f"{name}.{2 * conv}", weights))
    return x


def _conv(x: ov.Node, name: str, weights: Weights) -> ov.Node:
    kernel = weights[f"{name}.weight"]
    margin = [kernel.shape[-1] // 2] * 2
    bias = weights[f"{name}.bias"].reshape(1, -1, 1, 1)
    return op.add(op.convolution(x, kernel, [1, 1], margin, margin, [1, 1]), bias)

"""The edge network as an OpenVINO graph, built from its weights without torch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import openvino as ov
from numpy.typing import NDArray
from openvino import opset13 as op

from airline.spec import UNetSpec

Weights = Mapping[str, NDArray[np.float32]]


def build(spec: UNetSpec, weights: Weights, rows: int, columns: int) -> ov.Model:
    """The layers of `airline.unet.UNet` for one image size.

    What comes before and after them is `airline.runtimes.fold`: as graph nodes it took longer than the convolutions.

    Args:
        spec, weights: see `airline.weights.load_weights`.
        rows, columns: of the first level.

    Returns:
        A model from (1, C, rows, columns) float32 channels to (1, rows, columns, unshuffle * unshuffle) float32 logits.
    """
    planes = op.parameter([1, spec.unshuffle**2 + spec.smoothed, rows, columns], np.float32, name="planes")
    x: ov.Node = planes
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
    # with the channels last, as the convolution leaves them
    logits = op.transpose(_conv(x, "head", weights), np.array([0, 2, 3, 1]))
    return ov.Model([logits], [planes], "edges")


def _block(x: ov.Node, name: str, spec: UNetSpec, weights: Weights) -> ov.Node:
    for conv in range(spec.convs):
        x = op.relu(_conv(x, f"{name}.{2 * conv}", weights))
    return x


def _conv(x: ov.Node, name: str, weights: Weights) -> ov.Node:
    kernel = weights[f"{name}.weight"]
    margin = [kernel.shape[-1] // 2] * 2
    bias = weights[f"{name}.bias"].reshape(1, -1, 1, 1)
    return op.add(op.convolution(x, kernel, [1, 1], margin, margin, [1, 1]), bias)

"""The edge network as an OpenVINO graph, built from its weights without torch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import openvino as ov
from numpy.typing import NDArray
from openvino import opset13 as op

from airline.spec import UNetSpec

Weights = Mapping[str, NDArray[np.float32]]


def build(spec: UNetSpec, weights: Weights, rows: int, columns: int, codes: ov.Type = ov.Type.f32) -> ov.Model:
    """The layers of `airline.unet.UNet` for one image size.

    What comes before and after them is `airline.runtimes.fold`: as graph nodes it took longer than the convolutions.

    Args:
        spec, weights: see `airline.weights.load_weights`.
        rows, columns: of the first level.
        codes: numbers of input and output, float32 or bfloat16.

    Returns:
        A model from (1, rows, columns, C) channels to (1, rows, columns, unshuffle * unshuffle) logits. The channels
        are last, and the numbers those of the convolutions, so that neither needs a pass over the image.
    """
    planes = op.parameter([1, rows, columns, spec.unshuffle**2 + spec.smoothed], codes, name="planes")
    x: ov.Node = op.convert(op.transpose(planes, np.array([0, 3, 1, 2])), np.float32)
    skips = []
    for level in range(spec.levels):
        if level:
            x = op.max_pool(x, [2, 2], [1, 1], [0, 0], [0, 0], [2, 2]).output(0)
        x = _block(x, f"down.{level}", spec, weights)
        skips.append(x)
    for level in reversed(range(spec.levels - 1)):
        size = rows >> level, columns >> level, spec.widths[level]
        x = _add_coarse(skips[level], _conv(x, f"lateral.{level}", weights), size)
        x = _block(x, f"up.{level}", spec, weights)
    logits = op.convert(op.transpose(_conv(x, "head", weights), np.array([0, 2, 3, 1])), codes)
    return ov.Model([logits], [planes], "edges")


def _add_coarse(fine: ov.Node, coarse: ov.Node, size: tuple[int, int, int]) -> ov.Node:
    """A map plus one of half the size, each pixel of which counts for four.

    By broadcasting, so that the enlarged map is never written; with the channels last, as the convolutions leave them.
    """
    rows, columns, channels = size
    fine = op.transpose(fine, np.array([0, 2, 3, 1]))
    coarse = op.transpose(coarse, np.array([0, 2, 3, 1]))
    blocks = op.reshape(fine, [1, rows // 2, 2, columns // 2, 2, channels], special_zero=False)
    single = op.reshape(coarse, [1, rows // 2, 1, columns // 2, 1, channels], special_zero=False)
    total = op.reshape(op.add(blocks, single), [1, rows, columns, channels], special_zero=False)
    return op.transpose(total, np.array([0, 3, 1, 2]))


def _block(x: ov.Node, name: str, spec: UNetSpec, weights: Weights) -> ov.Node:
    for conv in range(spec.convs):
        x = op.relu(_conv(x, f"{name}.{2 * conv}", weights))
    return x


def _conv(x: ov.Node, name: str, weights: Weights) -> ov.Node:
    kernel = weights[f"{name}.weight"]
    margin = [kernel.shape[-1] // 2] * 2
    bias = weights[f"{name}.bias"].reshape(1, -1, 1, 1)
    return op.add(op.convolution(x, kernel, [1, 1], margin, margin, [1, 1]), bias)

"""The edge network as an OpenVINO graph, built from its weights without torch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import openvino as ov
from numpy.typing import NDArray
from openvino import opset13 as op

from airline.spec import UNetSpec

Weights = Mapping[str, NDArray[np.float32]]


def build(
    spec: UNetSpec, weights: Weights, rows: int, columns: int, codes: ov.Type = ov.Type.f32, pairs: bool = False
) -> ov.Model:
    """The layers of `airline.unet.UNet` for one image size.

    What comes before and after them is `airline.runtimes.fold`: as graph nodes it took longer than the convolutions.

    Args:
        spec, weights: see `airline.weights.load_weights`.
        rows, columns: of the first level.
        codes: numbers of input and output, float32 or bfloat16.
        pairs: convolve the last map two pixels at a time, as if it had half the columns and twice the channels: half
            of the weights are zeros then, but where there are matrix units, which so few channels do not fill, that
            is faster. Columns must be even.

    Returns:
        A model from (1, rows, columns, C) channels to (1, rows, columns, unshuffle * unshuffle) logits. The channels
        are last, and the numbers those of the convolutions, so that neither needs a pass over the image.
    """
    planes = op.parameter([1, rows, columns, spec.unshuffle**2 + spec.smoothed], codes, name="planes")
    x: ov.Node = _channels_second(op.convert(planes, np.float32))
    skips = []
    for level in range(spec.levels):
        if level:
            x = op.max_pool(x, [2, 2], [1, 1], [0, 0], [0, 0], [2, 2]).output(0)
        x = _block(x, f"down.{level}", spec, weights)
        skips.append(x)
    run = 1
    for level in reversed(range(spec.levels - 1)):
        size = rows >> level, columns >> level, spec.widths[level]
        run = 2 if pairs and level == 0 else 1
        x = _add_coarse(skips[level], _conv(x, f"lateral.{level}", weights, copies=2), size, run)
        x = _block(x, f"up.{level}", spec, weights, run)
    logits = _channels_last(_conv(x, "head", weights, run))
    logits = op.reshape(logits, [1, rows, columns, spec.unshuffle**2], special_zero=False)
    return ov.Model([op.convert(logits, codes)], [planes], "edges")


def _add_coarse(fine: ov.Node, coarse: ov.Node, size: tuple[int, int, int], run: int) -> ov.Node:
    """A map plus one of half the size, each pixel of which counts for four, with `run` pixels of a row as one.

    The coarse map has its channels twice, which with the channels last is each pixel twice, and is broadcast over two
    rows, so that the enlarged map is never written.
    """
    rows, columns, channels = size
    fine = op.reshape(_channels_last(fine), [1, rows // 2, 2, columns * channels], special_zero=False)
    coarse = op.reshape(_channels_last(coarse), [1, rows // 2, 1, columns * channels], special_zero=False)
    total = op.reshape(op.add(fine, coarse), [1, rows, columns // run, channels * run], special_zero=False)
    return _channels_second(total)


def _block(x: ov.Node, name: str, spec: UNetSpec, weights: Weights, run: int = 1) -> ov.Node:
    for conv in range(spec.convs):
        x = op.relu(_conv(x, f"{name}.{2 * conv}", weights, run))
    return x


def _conv(x: ov.Node, name: str, weights: Weights, run: int = 1, copies: int = 1) -> ov.Node:
    """A convolution of a map with `run` pixels of a row as one, answering each channel `copies` times."""
    kernel = np.tile(_for_runs(weights[f"{name}.weight"], run), (copies, 1, 1, 1))
    bias = np.tile(weights[f"{name}.bias"], run * copies).reshape(1, -1, 1, 1)
    margin = [side // 2 for side in kernel.shape[2:]]
    return op.add(op.convolution(x, kernel, [1, 1], margin, margin, [1, 1]), bias)


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

"""The edge network in OpenVINO on the CPU, built from its weights without torch."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import openvino as ov
from numpy.typing import NDArray
from openvino import opset13 as op

from airline.image import Gray, mean_and_deviation
from airline.network.runtimes import has_bf16
from airline.network.spec import SIZES, UNetSpec
from airline.network.weights import load_weights

# The only one, kept to the end of the process. On processors with matrix units each `Core` gives the thread that makes
# it a stack for signals, and gives the thread that drops it what the first one had before. With several of them that
# stack may be gone: the next signal that Python handles, such as Ctrl-C, would kill the process.
CORE = ov.Core()


class OpenVinoNetwork:
    """A U-Net compiled for the size of the image at hand, which takes a tenth of a second; see `EdgeNetwork`.

    It works in bfloat16 where the processor is made for that, else in float32. Raises WeightsError.
    """

    def __init__(self, weights: str | Path, threads: int | None = None) -> None:
        self._spec, self._weights = load_weights(weights)
        offered = "BF16" in CORE.get_property("CPU", "OPTIMIZATION_CAPABILITIES")
        self._precision = "bf16" if offered and has_bf16() else "f32"
        self._threads = {} if threads is None else {"INFERENCE_NUM_THREADS": threads}
        self._request = lru_cache(SIZES)(self._compiled)
        self._lock = threading.Lock()

    @property
    def name(self) -> str:
        return f"openvino {self._precision}"

    def __call__(self, gray: Gray) -> NDArray[np.float32]:
        with self._lock:
            request = self._request(*self._spec.folded_size(*gray.shape))
            encode_input(gray, self._spec, request.get_input_tensor().data[0])
            request.infer()
            return decode_output(request.get_output_tensor().data[0], *gray.shape)

    def _compiled(self, rows: int, columns: int) -> ov.InferRequest:
        options = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_PRECISION_HINT": self._precision, **self._threads}
        graph = _graph(self._spec, self._weights, rows, columns)
        return CORE.compile_model(graph, "CPU", options).create_infer_request()


def encode_input(gray: Gray, spec: UNetSpec, planes: NDArray[np.float32]) -> None:
    """Fill `planes`, (rows, columns, C) of `UNetSpec.folded_size`: normalised pixels of blocks, and smoothed copies.

    The same as in `UNet.answer`; as nodes of the graph these took longer than its convolutions.
    """
    (height, width), (rows, columns, _), side = gray.shape, planes.shape, spec.unshuffle
    mean, deviation = mean_and_deviation(gray)
    filled = cv2.copyMakeBorder(gray, 0, side * rows - height, 0, side * columns - width, cv2.BORDER_REPLICATE)
    image = (filled.astype(np.float32) - np.float32(mean)) * np.float32(1 / max(deviation, 1.0))
    blocks = image.reshape(rows, side, columns, side).transpose(0, 2, 1, 3)
    planes[..., : side * side] = blocks.reshape(rows, columns, side * side)
    means: Any = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
    for level in range(spec.smoothed):
        size = 2 * level + 3, 2 * level + 3
        sums, counts = (
            cv2.boxFilter(each, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
            for each in (means, np.ones_like(means))
        )
        means = sums / counts
        planes[..., side * side + level] = 2 * means


def decode_output(logits: NDArray[np.float32], height: int, width: int) -> NDArray[np.float32]:
    """(height, width) float32 edge probability of (rows, columns, side * side) float32 logits."""
    rows, columns, channels = logits.shape
    side = math.isqrt(channels)
    image = logits.reshape(rows, columns, side, side).transpose(0, 2, 1, 3).reshape(side * rows, side * columns)
    with np.errstate(over="ignore"):
        edges: NDArray[np.float32] = np.reciprocal(1 + np.exp(-image[:height, :width]))
    return edges


def _graph(spec: UNetSpec, weights: Mapping[str, NDArray[np.float32]], rows: int, columns: int) -> ov.Model:
    """The layers of `airline.network.unet.UNet`, from (1, rows, columns, C) to (1, rows, columns, unshuffle ** 2).

    The channels are last, as the convolutions take them, so that neither end needs a pass over the image.
    """

    def conv(x: Any, name: str, copies: int = 1) -> ov.Node:
        """A convolution that answers each channel so many times."""
        kernel, bias = (np.concatenate([weights[f"{name}.{part}"]] * copies) for part in ("weight", "bias"))
        margin = [kernel.shape[2] // 2] * 2
        return op.add(op.convolution(x, kernel, [1, 1], margin, margin, [1, 1]), bias.reshape(1, -1, 1, 1))

    def block(x: Any, name: str) -> ov.Node:
        for index in range(spec.convs):
            x = op.relu(conv(x, f"{name}.{2 * index}"))
        return x

    def add_coarse(fine: Any, coarse: Any, level: int) -> ov.Node:
        """A level's map plus the coarser one, each pixel of which counts for four.

        The coarse map gets its channels twice, which with the channels last is each pixel twice, and is broadcast over
        two rows, so that the enlarged map is never written.
        """
        high, wide, channels = rows >> level, columns >> level, spec.widths[level]
        coarse = _channels_last(conv(coarse, f"lateral.{level}", copies=2))
        fine = op.reshape(_channels_last(fine), [1, high // 2, 2, wide * channels], special_zero=False)
        coarse = op.reshape(coarse, [1, high // 2, 1, wide * channels], special_zero=False)
        return _channels_second(op.reshape(op.add(fine, coarse), [1, high, wide, channels], special_zero=False))

    planes = op.parameter([1, rows, columns, spec.unshuffle**2 + spec.smoothed], np.float32, name="planes")
    x, skips = _channels_second(planes), []
    for level in range(spec.levels):
        if level:
            x = op.max_pool(x, [2, 2], [1, 1], [0, 0], [0, 0], [2, 2]).output(0)
        x = block(x, f"down.{level}")
        skips.append(x)
    for level in reversed(range(spec.levels - 1)):
        x = block(add_coarse(skips[level], x, level), f"up.{level}")
    return ov.Model([_channels_last(conv(x, "head"))], [planes], "edges")


def _channels_last(x: Any) -> ov.Node:
    return op.transpose(x, np.array([0, 2, 3, 1]))


def _channels_second(x: Any) -> ov.Node:
    return op.transpose(x, np.array([0, 3, 1, 2]))

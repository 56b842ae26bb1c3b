"""The edge network in OpenVINO on the CPU."""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import openvino as ov
from numpy.typing import NDArray

from airline.image import Gray
from airline.runtimes.openvino_graph import build
from airline.weights import load_weights

_SIZES = 4  # image sizes that are kept compiled


class OpenVinoNetwork:
    """A U-Net compiled for the size of the image at hand; see `EdgeNetwork`.

    Compiling takes about a tenth of a second per size, so nothing is cached on disk.

    Args:
        weights: name of bundled weights, or path of a weights file.

    Raises:
        WeightsError: the weights cannot be used.
    """

    def __init__(self, weights: str | Path) -> None:
        self._spec, self._weights = load_weights(weights)
        self._core = ov.Core()
        has_bf16 = "BF16" in self._core.get_property("CPU", "OPTIMIZATION_CAPABILITIES")
        self._precision = "bf16" if has_bf16 else "f32"
        self._requests: OrderedDict[tuple[Any, ...], ov.InferRequest] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def name(self) -> str:
        return f"openvino {self._precision}"

    def __call__(self, gray: Gray) -> NDArray[np.float32]:
        mean, std = (float(value[0, 0]) for value in cv2.meanStdDev(gray))
        factor = 1 / max(std, 1.0)  # as `airline.unet.normalise`
        image: NDArray[Any] = np.ascontiguousarray(gray)
        if image.dtype == np.uint8:  # bfloat16 holds whole numbers up to 256 exactly, so the mean goes in two parts
            scale = np.array([round(mean), factor, (round(mean) - mean) * factor], np.float32)
        else:
            image = (image - np.float32(mean)) * np.float32(factor)
            scale = np.array([0, 1, 0], np.float32)
        edges = np.empty(gray.shape, np.float32)
        with self._lock:
            request = self._request(image)
            request.set_input_tensor(0, ov.Tensor(image[None, None], shared_memory=True))
            request.set_input_tensor(1, ov.Tensor(scale, shared_memory=True))
            request.set_output_tensor(ov.Tensor(edges, shared_memory=True))
            request.infer()
        return edges

    def _request(self, image: NDArray[Any]) -> ov.InferRequest:
        key = (*image.shape, str(image.dtype))
        if key not in self._requests:
            height, width = image.shape
            model = build(self._spec, self._weights, height, width, image.dtype)
            options = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_PRECISION_HINT": self._precision}
            self._requests[key] = self._core.compile_model(model, "CPU", options).create_infer_request()
            if len(self._requests) > _SIZES:
                self._requests.popitem(last=False)
        self._requests.move_to_end(key)
        return self._requests[key]

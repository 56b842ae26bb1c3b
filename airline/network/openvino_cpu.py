"""The edge network in OpenVINO on the CPU."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import openvino as ov
from numpy.typing import NDArray

from airline.image import Gray
from airline.kernels.threads import ThreadTeam
from airline.network.encoding import Codes, fold, folded_size, unfold
from airline.network.openvino_core import core
from airline.network.openvino_graph import build
from airline.network.processor import has_amx, has_bf16, has_vnni
from airline.network.size_cache import Sizes
from airline.network.weights import load_ranges, load_weights

CODES: dict[ov.Type, type[np.uint16] | type[np.uint32]] = {ov.Type.bf16: np.uint16, ov.Type.f32: np.uint32}
FEW_CHANNELS = {"bf16": 32, "int8": 16, "f32": 0}  # fewer do not fill matrix units, which take no f32


@dataclass(frozen=True)
class _Sized:
    """The network for one size, and the arrays that it reads and writes: rows, columns and channels of codes."""

    request: ov.InferRequest
    planes: Codes
    logits: Codes


class OpenVinoNetwork:
    """A U-Net compiled for the size of the image at hand; see `EdgeNetwork`.

    Compiling takes about a tenth of a second per size, so nothing is cached on disk.

    Args:
        weights: name of bundled weights, or path of a weights file.
        threads: at most so many; all cores by default.

    Raises:
        WeightsError: the weights cannot be used.
    """

    def __init__(self, weights: str | Path, threads: int | None = None) -> None:
        self._spec, self._weights = load_weights(weights)
        self._core = core()
        self._ranges = load_ranges(weights)
        self._numbers = self._fastest()
        narrow = has_vnni() and bool(self._ranges)
        self._precision = "int8" if narrow else self._numbers.get_type_name()
        self._threads = threads
        self._team = ThreadTeam(threads)
        self._sizes = Sizes(self._sized)
        self._lock = threading.Lock()

    @property
    def name(self) -> str:
        return f"openvino {self._precision}"

    def __call__(self, gray: Gray) -> NDArray[np.float32]:
        height, width = gray.shape
        with self._lock:
            sized = self._sizes.of(*folded_size(self._spec, height, width))
            fold(gray, self._spec, sized.planes, self._team)
            sized.request.infer()
            return unfold(sized.logits, self._spec.unshuffle, height, width, self._team)

    def _fastest(self) -> ov.Type:
        """Of what does not work in 8-bit numbers."""
        offered = "BF16" in self._core.get_property("CPU", "OPTIMIZATION_CAPABILITIES")
        return ov.Type.bf16 if offered and has_bf16() else ov.Type.f32

    def _sized(self, rows: int, columns: int) -> _Sized:
        ranges = self._ranges if self._precision == "int8" else None
        model = build(self._spec, self._weights, rows, columns, self._numbers, self._in_pairs(), ranges)
        options: dict[str, Any] = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_PRECISION_HINT": self._numbers}
        if self._threads is not None:
            options["INFERENCE_NUM_THREADS"] = self._threads
        request = self._core.compile_model(model, "CPU", options).create_infer_request()
        codes = CODES[self._numbers]
        return _Sized(
            request, *(tensor.data[0].view(codes) for tensor in request.input_tensors + request.output_tensors)
        )

    def _in_pairs(self) -> bool:
        return has_amx() and self._spec.widths[0] < FEW_CHANNELS[self._precision]

"""Where the edge network runs: SIMD code of our own, OpenVINO, torch, CUDA. Every one gives the same edges."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from airline.config import Runtime
from airline.errors import ConfigError, from_extra
from airline.image import Gray

if TYPE_CHECKING:
    from airline.network.unet import UNet


class EdgeNetwork(Protocol):
    """A network that is ready to run."""

    @property
    def name(self) -> str:
        """The runtime and its precision, such as "native int8"."""
        ...

    def __call__(self, gray: Gray) -> NDArray[np.float32]:
        """(H, W) uint8 or uint16 image of any size to (H, W) float32 edge probability, an array of the caller's own."""
        ...


def open_network(weights: str | Path | UNet, runtime: Runtime = "auto", threads: int | None = None) -> EdgeNetwork:
    """Load the edge network.

    Args:
        weights: name of bundled weights, path of a file written by `airline.train`, or a network itself, for torch.
        runtime: "native" (8-bit numbers on x86), "openvino" (bfloat16 where the processor is made for it, else
            float32), "torch" (float32 on the CPU), "cuda" (half precision), or "auto": CUDA where there is such a
            device, else the first of these that is here and fits the processor and the network.
        threads: how many of the processor's cores "native" and OpenVINO work on; all by default.

    Raises:
        WeightsError: the weights are missing, damaged or made for another network.
        ConfigError: the runtime is not here, or cannot take these weights.
    """
    if runtime == "auto":
        runtime = _best(weights)
    if runtime in ("torch", "cuda"):
        from airline.network.torch_runtimes import CudaNetwork, TorchNetwork

        return CudaNetwork(weights) if runtime == "cuda" else TorchNetwork(weights)
    if not isinstance(weights, (str, Path)):
        raise ConfigError(f"the runtime {runtime} takes weights from a file: save the network, or use torch")
    if runtime == "native":
        from airline.network.native.network import NativeNetwork

        return NativeNetwork(weights, threads)
    with from_extra("openvino"):
        from airline.network.openvino_cpu import OpenVinoNetwork
    return OpenVinoNetwork(weights, threads)


def _best(weights: str | Path | UNet) -> Runtime:
    if shutil.which("nvidia-smi"):  # asking torch takes a second, which machines without such a driver need not wait
        import torch

        if torch.cuda.is_available():
            return "cuda"
    if not isinstance(weights, (str, Path)):
        return "torch"
    from airline.network.native.network import suits

    if suits(weights):
        return "native"
    return "openvino" if importlib.util.find_spec("openvino") else "torch"

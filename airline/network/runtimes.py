"""Where the edge network runs: vector code of our own, OpenVINO, torch, CUDA. Every one gives the same edges."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from airline.config import Runtime
from airline.errors import ConfigError
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
        runtime: "native" (8-bit numbers on x86), "openvino" (8-bit numbers or bfloat16 where the processor is made for
            them, else float32), "torch" (float32 on the CPU), "cuda" (half precision), or "auto": CUDA where there is
            such a device, else the first of these that fits the processor and the network.
        threads: how many of the processor's cores "native" and OpenVINO work on; all by default.

    Raises:
        WeightsError: the weights are missing, damaged or made for another network.
        ConfigError: the runtime is not here, or cannot take these weights.
    """
    if runtime == "auto":
        runtime = _best(weights)
    if runtime == "native":
        if not isinstance(weights, (str, Path)):
            raise ConfigError("the runtime native takes weights from a file: save the network, or use torch")
        from airline.network.native.network import NativeNetwork

        return NativeNetwork(weights, threads)
    if runtime == "openvino":
        if not isinstance(weights, (str, Path)):
            raise ConfigError("OpenVINO takes weights from a file: save the network, or use the runtime torch")
        try:
            from airline.network.openvino_cpu import OpenVinoNetwork
        except ImportError as error:
            raise ConfigError(f"OpenVINO cannot be used ({error}): install openvino, or use --runtime torch") from error
        return OpenVinoNetwork(weights, threads)
    if runtime == "cuda":
        from airline.network.torch_cuda import CudaNetwork

        return CudaNetwork(weights)
    from airline.network.torch_cpu import TorchNetwork

    return TorchNetwork(weights)


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

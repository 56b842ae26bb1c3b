"""Where the edge network runs: SIMD code of our own, OpenVINO, torch, CUDA. Every one gives the same edges."""

from __future__ import annotations

import importlib.util
import os
import shutil
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import llvmlite.binding
import numpy as np
from numpy.typing import NDArray

from airline.config import Runtime
from airline.errors import ConfigError, from_extra
from airline.image import Gray

if TYPE_CHECKING:
    from airline.network.unet import UNet

# Numba compiles anew for tuples of other lengths. The first one's is the number of 32-bit lanes; the second one is
# empty without VNNI, whose instructions multiply and add at once: then the sum of two products has to fit into 16 bits,
# and weights have 7.
Isa = tuple[tuple[int, ...], tuple[int, ...]]
AVX512_VNNI: Isa = ((0,) * 16, (0,))
AVX2_VNNI: Isa = ((0,) * 8, (0,))
AVX2: Isa = ((0,) * 8, ())


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
    """Load the edge network; raises WeightsError, and ConfigError where the runtime is not here or does not take it.

    Args:
        weights: name of bundled weights, path of a file written by `airline.train`, or a network itself, for torch.
        runtime: "native" (8-bit numbers on x86), "openvino" (bfloat16 where the processor is made for it, else
            float32), "torch" (float32 on the CPU), "cuda" (half precision), or "auto": CUDA where there is such a
            device, else the first of these that is here and fits the processor and the network.
        threads: how many of the processor's cores "native" and OpenVINO work on; all by default.
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


def has_bf16() -> bool:
    """Whether it multiplies bfloat16 numbers; OpenVINO also offers to imitate it, three times slower than float32."""
    if not _has("sse2"):  # other than x86, where OpenVINO is believed
        return True
    return (_has("amx-bf16") and _allowed("AMX")) or (_has("avx512bf16") and _allowed("BF16", "FP16", "AMX"))


def vector_instructions() -> Isa | None:
    """Which of its SIMD instructions the runtime "native" uses; None where it has none of them."""
    if (_has("avx512vnni") or _has("avxvnni")) and _allowed("VNNI", "BF16", "FP16", "AMX"):
        wide = _has("avx512vnni") and _has("avx512bw") and _allowed("AVX512", "AVX10")
        return AVX512_VNNI if wide else AVX2_VNNI
    return AVX2 if _has("avx2") and _has("fma") and _allowed("AVX") else None


@cache
def _has(feature: str) -> bool:
    return bool(llvmlite.binding.get_host_cpu_features().get(feature, False))


def _allowed(*parts: str) -> bool:
    """Whether oneDNN, and so OpenVINO, may use it: the variable makes a new processor pass for an old one."""
    limit = os.environ.get("ONEDNN_MAX_CPU_ISA", "ALL").upper()
    return limit in ("ALL", "DEFAULT") or any(part in limit for part in parts)

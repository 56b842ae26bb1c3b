"""The edge network in torch: on the CPU, which works everywhere, and on a GPU."""

from __future__ import annotations

import threading
from collections.abc import Callable
from copy import deepcopy
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.image import Gray
from airline.network.spec import SIZES
from airline.network.unet import UNet
from airline.network.weights import load_unet

_WARM_UP = 3  # runs in which torch chooses its kernels: a graph must not hold that

Network = Callable[[torch.Tensor], torch.Tensor]
Capture = Callable[[Network, torch.Tensor], Callable[[], torch.Tensor]]


class TorchNetwork:
    """A U-Net in float32, eager, channels last; see `EdgeNetwork`. Raises WeightsError."""

    name = "torch cpu f32"

    def __init__(self, weights: str | Path | UNet) -> None:
        net = weights if isinstance(weights, UNet) else load_unet(weights)
        self._net: UNet = net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def __call__(self, gray: Gray) -> NDArray[np.float32]:
        with torch.inference_mode():
            image = torch.from_numpy(gray.astype(np.float32))[None, None]
            edges: NDArray[np.float32] = torch.sigmoid(self._net.answer(image)[0, 0]).contiguous().numpy()
        return edges


def captured(network: Network, image: torch.Tensor) -> Callable[[], torch.Tensor]:
    """The network's answer to what is in `image` by then, as one call of the GPU, always into the same memory."""
    side = torch.cuda.Stream()  # type: ignore[no-untyped-call]
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        for _ in range(_WARM_UP):
            network(image)
    torch.cuda.current_stream().wait_stream(side)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, capture_error_mode="thread_local"):
        answer = network(image)

    def replay() -> torch.Tensor:
        graph.replay()
        return answer

    return replay


class CudaNetwork:
    """A U-Net on a GPU, in bfloat16 or, where the GPU has none, in float16; see `EdgeNetwork`.

    It is done sooner than Python can start its layers one by one, so they are captured for each size and kind of image
    as a CUDA graph. Raises WeightsError, and ConfigError without a GPU; `device` and `capture` are for tests.
    """

    def __init__(self, weights: str | Path | UNet, device: str = "cuda", capture: Capture = captured) -> None:
        self._on_gpu = device == "cuda"
        if self._on_gpu and not torch.cuda.is_available():
            raise ConfigError("no CUDA device is available: use --runtime auto")
        self._half = torch.float16 if self._on_gpu and not torch.cuda.is_bf16_supported() else torch.bfloat16
        net = deepcopy(weights) if isinstance(weights, UNet) else load_unet(weights)  # the caller's stays as it is
        self._net: UNet = net.to(device, self._half).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._device, self._capture = device, capture
        self._ready = lru_cache(SIZES)(self._get_ready)
        self._lock = threading.Lock()

    @property
    def name(self) -> str:
        numbers = "f16" if self._half == torch.float16 else "bf16"
        return f"torch {torch.cuda.get_device_name() if self._on_gpu else self._device} {numbers}"

    def __call__(self, gray: Gray) -> NDArray[np.float32]:
        with self._lock, torch.inference_mode():
            given, image, run, edges = self._ready(gray.shape, torch.uint8 if gray.dtype == np.uint8 else torch.int32)
            given.numpy()[...] = gray
            image.copy_(given, non_blocking=True)
            edges.copy_(run(), non_blocking=True)
            if self._on_gpu:
                torch.cuda.current_stream().synchronize()
            found: NDArray[np.float32] = edges.numpy().copy()
        return found

    def _get_ready(
        self, shape: tuple[int, ...], kind: torch.dtype
    ) -> tuple[torch.Tensor, torch.Tensor, Callable[[], torch.Tensor], torch.Tensor]:
        """Pinned memory for the image, the GPU's, the network, and pinned memory for the edges."""
        given = torch.empty(shape, dtype=kind, pin_memory=self._on_gpu)
        image = torch.zeros(shape, dtype=kind, device=self._device)
        edges = torch.empty(shape, dtype=torch.float32, pin_memory=self._on_gpu)
        return given, image, self._capture(self._edges, image), edges

    def _edges(self, image: torch.Tensor) -> torch.Tensor:
        return torch.sigmoid(self._net.answer(image.float()[None, None])[0, 0].float()).contiguous()

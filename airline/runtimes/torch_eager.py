"""The edge network in torch, eager and channels-last: works everywhere, and on CUDA."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.image import Gray
from airline.unet import UNet
from airline.weights import load_unet


class TorchNetwork:
    """A U-Net in float32; see `EdgeNetwork`.

    Args:
        weights: see `open_network`.
        cuda: on the GPU.

    Raises:
        WeightsError: the weights cannot be used.
        ConfigError: there is no CUDA device.
    """

    def __init__(self, weights: str | Path | UNet, *, cuda: bool = False) -> None:
        if cuda and not torch.cuda.is_available():
            raise ConfigError("no CUDA device is available: use --runtime auto")
        self._device = torch.device("cuda" if cuda else "cpu")
        net = weights if isinstance(weights, UNet) else load_unet(weights)
        self._net: UNet = net.to(self._device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def name(self) -> str:
        return f"torch {self._device.type} f32"

    def __call__(self, gray: Gray) -> NDArray[np.float32]:
        with torch.inference_mode():
            image = torch.from_numpy(gray.astype(np.float32))[None, None].to(self._device)
            edges: NDArray[np.float32] = torch.sigmoid(self._net.answer(image)[0, 0]).contiguous().cpu().numpy()
        return edges

"""The edge network in torch on the CPU, eager and channels-last: works everywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from airline.image import Gray
from airline.network.unet import UNet
from airline.network.weights import load_unet


class TorchNetwork:
    """A U-Net in float32; see `EdgeNetwork`.

    Args:
        weights: see `open_network`.

    Raises:
        WeightsError: the weights cannot be used.
    """

    def __init__(self, weights: str | Path | UNet) -> None:
        net = weights if isinstance(weights, UNet) else load_unet(weights)
        self._net: UNet = net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def name(self) -> str:
        return "torch cpu f32"

    def __call__(self, gray: Gray) -> NDArray[np.float32]:
        with torch.inference_mode():
            image = torch.from_numpy(gray.astype(np.float32))[None, None]
            edges: NDArray[np.float32] = torch.sigmoid(self._net.answer(image)[0, 0]).contiguous().numpy()
        return edges

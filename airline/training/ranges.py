"""How large the numbers inside a network get, which inference in 8-bit numbers must know."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from airline.network.unet import UNet
from airline.network.weights import Ranges

BEYOND = 1e-5  # share of an image's numbers that may lie beyond a range, on either side,
IMAGES = 0.95  # in so many of the images: one odd image must not take the others' precision


def measure_ranges(net: UNet, images: Iterable[NDArray[np.uint8]]) -> Ranges:
    """Least and largest input of each convolution but the first, by its name, over most of some (H, W) uint8 images.

    `net` has its normalisation folded.
    """
    found: dict[str, list[tuple[float, float]]] = {}

    def note(name: str, values: torch.Tensor) -> None:
        numbers = values.flatten().numpy()
        rank = int(BEYOND * len(numbers))
        ordered = np.partition(numbers, (rank, len(numbers) - 1 - rank))
        found.setdefault(name, []).append((float(ordered[rank]), float(ordered[len(numbers) - 1 - rank])))

    convs = {name: part for name, part in net.named_modules() if isinstance(part, nn.Conv2d) and name != "down.0.0"}
    hooks = [
        conv.register_forward_pre_hook(lambda _, inputs, name=name: note(name, inputs[0]))
        for name, conv in convs.items()
    ]
    try:
        with torch.inference_mode():
            for image in images:
                net.answer(torch.from_numpy(image.astype(np.float32))[None, None])
    finally:
        for hook in hooks:
            hook.remove()
    return {name: _of_most(*np.array(each).T) for name, each in found.items()}


def _of_most(lows: NDArray[np.float64], highs: NDArray[np.float64]) -> tuple[float, float]:
    return float(np.quantile(lows, 1 - IMAGES, method="lower")), float(np.quantile(highs, IMAGES, method="higher"))

"""The edge loss."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional


def disk(radius: int) -> NDArray[np.uint8]:
    """(2r+1, 2r+1) mask of the offsets within `radius` px."""
    axis = np.arange(-radius, radius + 1)
    return ((axis[:, None] ** 2 + axis[None] ** 2) <= radius**2).astype(np.uint8)


@dataclass(frozen=True)
class PixelWeights:
    """How much each pixel of a labelled crop counts: `(1 - w) + w * dilate_r(Y > 0)` (equation 1 of the AirLine paper).

    Pixels within `radius` of a line weigh 1, the others 1 - w, so that false positives far from any line cost little
    and edges stay continuous.

    Attributes:
        weight: w in [0, 1].
        radius: r, px, of a disk.
    """

    weight: float = 0.8
    radius: int = 5

    def __call__(self, target: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.float32]:
        """(H, W) float32 weights of an (H, W) soft edge map; pixels outside the photograph weigh nothing."""
        near = cv2.dilate((target > 0.1).astype(np.uint8), disk(self.radius))
        weights: NDArray[np.float32] = ((1 - self.weight) + self.weight * near) * inside
        return weights.astype(np.float32)


def edge_loss(logits: torch.Tensor, target: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Weighted mean of the binary cross entropy with soft targets, a scalar.

    Args:
        logits: (B, 1, H, W) predictions before the sigmoid.
        target: (B, 1, H, W) in [0, 1].
        weights: (B, 1, H, W) of `PixelWeights`.
    """
    total = functional.binary_cross_entropy_with_logits(logits.float(), target, weights, reduction="sum")
    return total / weights.sum()

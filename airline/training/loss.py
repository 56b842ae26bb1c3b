"""The edge loss."""

from __future__ import annotations

import torch
from torch.nn import functional


def disk(radius: int) -> torch.Tensor:
    """(1, 1, 2r+1, 2r+1) float mask of the offsets within `radius` px."""
    axis = torch.arange(-radius, radius + 1)
    return ((axis[:, None] ** 2 + axis[None] ** 2) <= radius**2).float()[None, None]


def edge_loss(
    logits: torch.Tensor, target: torch.Tensor, inside: torch.Tensor, weight: float = 0.8, radius: int = 5
) -> torch.Tensor:
    """Weighted masked binary cross entropy, equation 1 of the AirLine paper, with soft targets.

    `((1 - w) + w * dilate_r(Y > 0)) * BCE(X, Y)`: pixels within `radius` of a line weigh 1, the others 1 - w, so that
    false positives far from any line cost little and edges stay continuous.

    Args:
        logits: (B, 1, H, W) predictions before the sigmoid.
        target: (B, 1, H, W) in [0, 1].
        inside: (B, 1, H, W) bool, pixels that count at all.
        weight: w.
        radius: r, px, of a disk.

    Returns:
        The weighted mean, a scalar.
    """
    near = functional.conv2d((target > 0.1).float(), disk(radius).to(target), padding=radius) > 0
    weights = ((1 - weight) + weight * near.float()) * inside
    losses = functional.binary_cross_entropy_with_logits(logits.float(), target, reduction="none")
    return (weights * losses).sum() / weights.sum()

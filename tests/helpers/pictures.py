"""Pictures of boxes, for training tests."""

from __future__ import annotations

import cv2
import numpy as np

from airline.training.consensus import consensus
from airline.training.dataset import Sample


def picture(seed: int = 0, width: int = 160, height: int = 160) -> np.ndarray:
    """Six boxes with a little blur and noise, grey."""
    rng = np.random.default_rng(seed)
    image = np.full((height, width), 110, np.uint8)
    for _ in range(6):
        box = rng.integers(0, (width, height), (2, 2))
        cv2.rectangle(image, box[0].tolist(), box[1].tolist(), int(rng.integers(0, 255)), -1)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.7) + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)


def labelled(seed: int, width: int = 160, height: int = 160) -> Sample:
    """A picture with its pseudo-labels."""
    gray = picture(seed, width, height)
    return Sample(gray, *consensus(gray, 2, np.random.default_rng(seed)))

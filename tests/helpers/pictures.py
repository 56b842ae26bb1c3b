"""Pictures for training and for edge networks, and how close two networks' edges must be."""

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


WITHIN = {"f32": (1e-4, 1e-6), "bf16": (0.06, 0.002)}  # largest and mean difference


def pictures(scene: np.ndarray) -> list[np.ndarray]:
    """The scene in several sizes, mirrored, in low contrast, and dark in 16 bits."""
    low_contrast = (195 + scene / 25).astype(np.uint8)
    dark16 = (scene.astype(np.uint16) // 4 + 20_000).astype(np.uint16)
    return [scene, scene[:240, 5:219], scene[::2, ::3], scene[:, ::-1], low_contrast, dark16]


def assert_close(ours: np.ndarray, theirs: np.ndarray, precision: str) -> None:
    """Edges differ by no more than `WITHIN`."""
    difference = np.abs(ours - theirs)
    assert ours.shape == theirs.shape
    assert ours.dtype == theirs.dtype == np.float32
    assert difference.max() <= WITHIN[precision][0]
    assert difference.mean() <= WITHIN[precision][1]

"""Pictures for edge networks, and how close two networks' edges must be."""

from __future__ import annotations

import numpy as np

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

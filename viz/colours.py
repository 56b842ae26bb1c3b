"""Colours of single detections: one per line angle, and a quiet one for segments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.colours import hsv_to_rgb

QUIET = (255, 196, 64)  # segments, which are not yet part of any track, RGB


def angle_colours(angles: NDArray[np.float32], strength: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Hue from the angle of an undirected line, brightness from its strength.

    Args:
        angles: (M,) radians; a half turn is once around the hue circle, so 0 and pi look the same (red).
        strength: (M,) in [0, 1]; 0 is black.

    Returns:
        (M, 3) uint8 RGB.
    """
    circle = hsv_to_rgb(np.arange(256) / 256, np.full(256, 0.75), np.ones(256))
    hue = np.rint(angles * (256 / np.pi)).astype(np.int32) % 256
    colours: NDArray[np.uint8] = (circle[hue] * strength[:, None]).astype(np.uint8)
    return colours

"""Colours of single detections: one per angle of a line, and a quiet one for segments."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from frontend.colours import hsv_to_rgb

ANGLES, STRENGTHS = 60, 4  # that colours tell apart: 3 degrees, and quarters of the edge probability
MIN_STRENGTH = 0.35
QUIET = (255, 196, 64)  # segments, which are not yet part of any track, RGB


@cache
def orientation_palette() -> NDArray[np.uint8]:
    """(1 + ANGLES * STRENGTHS, 3) uint8 RGB: black, then each angle in all strengths.

    A half turn of an undirected line is once around the hue circle, from red at 0. An edge is brighter the more
    probable it is, but never darker than `MIN_STRENGTH`.
    """
    angle, strength = np.divmod(np.arange(ANGLES * STRENGTHS), STRENGTHS)
    value = MIN_STRENGTH + (1 - MIN_STRENGTH) * strength / (STRENGTHS - 1)
    colours = hsv_to_rgb(angle / ANGLES, np.full(len(angle), 0.75), value)
    return np.concatenate([np.zeros((1, 3), np.uint8), colours])

"""Colours that stay with a track, wherever it is shown."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

GOLDEN_RATIO = (np.sqrt(5) - 1) / 2
CYCLE = 6765  # a multiple of 15, for the saturation, and a Fibonacci number, for the hue: no seam


def hsv_to_rgb(hue: ArrayLike, saturation: ArrayLike, value: ArrayLike) -> NDArray[np.uint8]:
    """(..., 3) uint8 RGB of HSV values in [0, 1]; the hue is periodic (Smith 1978, in closed form)."""
    sectors = (np.asarray(hue, float)[..., None] * 6 + np.array([5, 3, 1])) % 6
    distance = np.clip(np.minimum(sectors, 4 - sectors), 0, 1)
    rgb = np.asarray(value)[..., None] * (1 - np.asarray(saturation)[..., None] * distance)
    colours: NDArray[np.uint8] = np.rint(255 * rgb).astype(np.uint8)
    return colours


def track_colours(ids: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(N, 3) uint8 RGB that stay with (N,) int64 ids of tracks: bright, and far apart for ids that follow each other.

    Hues step by the golden ratio, which spreads any run of ids evenly; saturation changes more slowly, for ids whose
    hues come close again. After `CYCLE` ids the colours come round.
    """
    colours: NDArray[np.uint8] = _cycle()[ids % CYCLE]
    return colours


@cache
def _cycle() -> NDArray[np.uint8]:
    """(CYCLE, 3) uint8 RGB."""
    ids = np.arange(CYCLE)
    saturation = np.array([0.9, 0.65, 0.8])[(ids // 5) % 3]
    return hsv_to_rgb((ids * GOLDEN_RATIO) % 1, saturation, np.ones(CYCLE))

"""Colours that stay with a track, wherever it is shown."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

GOLDEN_RATIO = (np.sqrt(5) - 1) / 2
CYCLE = 6765  # a multiple of 15, for the saturation, and a Fibonacci number, for the hue: no seam
PALE = 0.55  # how far a tentative track's colour is moved towards white


def hsv_to_rgb(hue: ArrayLike, saturation: ArrayLike, value: ArrayLike) -> NDArray[np.uint8]:
    """(..., 3) uint8 RGB of HSV values in [0, 1]; the hue is periodic (Smith 1978, in closed form)."""
    sectors = (np.asarray(hue, float)[..., None] * 6 + np.array([5, 3, 1])) % 6
    distance = np.clip(np.minimum(sectors, 4 - sectors), 0, 1)
    rgb = np.asarray(value)[..., None] * (1 - np.asarray(saturation)[..., None] * distance)
    colours: NDArray[np.uint8] = np.rint(255 * rgb).astype(np.uint8)
    return colours


def track_colours(ids: NDArray[np.int64], confirmed: NDArray[np.bool_] | None = None) -> NDArray[np.uint8]:
    """Colours that stay with a track's id: bright, and far apart for ids that follow each other.

    Hues step by the golden ratio, which spreads any run of ids evenly; saturation changes more slowly, for ids whose
    hues come close again. After `CYCLE` ids the colours come round.

    Args:
        ids: (N,) int64 track ids.
        confirmed: (N,) mask; the others are drawn paler in the same hue. None: all confirmed.

    Returns:
        (N, 3) uint8 RGB.
    """
    bright, pale = (colours[ids % CYCLE] for colours in _cycle())
    return bright if confirmed is None else np.where(confirmed[:, None], bright, pale)


@cache
def _cycle() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """(CYCLE, 3) uint8 RGB each: bright and pale."""
    ids = np.arange(CYCLE)
    saturation = np.array([0.9, 0.65, 0.8])[(ids // 5) % 3]
    bright = hsv_to_rgb((ids * GOLDEN_RATIO) % 1, saturation, np.ones(CYCLE))
    return bright, np.rint(bright + PALE * (255.0 - bright)).astype(np.uint8)

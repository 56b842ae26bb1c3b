"""Colours and finishes of surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airline.scenes.textures import texture_index

Vec = tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """A texture that blends two colours.

    Attributes:
        texture: index into the texture bank.
        low, high: BGR linear albedo in [0, 1] where the texture is 0 and 1.
        tile: size of one texture tile, m.
    """

    texture: int
    low: Vec
    high: Vec
    tile: float


def colour(rng: np.random.Generator, value: tuple[float, float], saturation: tuple[float, float] = (0.05, 0.5)) -> Vec:
    """A random linear BGR colour with brightness and saturation within bounds."""
    hue, v, s = rng.uniform(0, 6), rng.uniform(*value), rng.uniform(*saturation)
    bgr = [v * (1 - s * min(1.0, max(0.0, abs((hue + shift) % 6 - 3) - 1))) for shift in (2.0, 4.0, 0.0)]
    return (bgr[0], bgr[1], bgr[2])


def finish(
    rng: np.random.Generator,
    name: str,
    base: Vec,
    tile: float = 1.0,
    contrast: float = 0.25,
    variant: int | None = None,
) -> Material:
    """A material whose colours lie around `base`, apart by the relative `contrast`."""
    variant = int(rng.integers(100)) if variant is None else variant
    low = (base[0] * (1 - contrast), base[1] * (1 - contrast), base[2] * (1 - contrast))
    high = (
        min(1.0, base[0] * (1 + contrast)),
        min(1.0, base[1] * (1 + contrast)),
        min(1.0, base[2] * (1 + contrast)),
    )
    return Material(texture_index(name, variant), low, high, tile)

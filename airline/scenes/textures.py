"""A small bank of seamless grey textures with mip levels.

Every face of a scene blends two colours by one of these. They are clutter on purpose: grain, blobs, stones and wavy
bricks make a naive detector fire, but they hold no long straight edge, so that they are not ground truth.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE = 256
LEVELS = 9
STRIDE = sum((SIZE >> level) ** 2 for level in range(LEVELS))

VARIANTS = 3
_Y, _X = np.mgrid[0:SIZE, 0:SIZE] / SIZE


def texture_index(name: str, variant: int) -> int:
    """Position of a texture in the bank; any integer is a valid variant."""
    return list(_PAINTERS).index(name) * VARIANTS + variant % VARIANTS


@lru_cache(maxsize=1)
def texture_bank() -> NDArray[np.uint8]:
    """(T * STRIDE,) uint8 bank: per texture, levels of SIZE, SIZE/2, ..., 1 px one after another."""
    return np.concatenate(
        [
            _pyramid(paint(np.random.default_rng([k, variant])))
            for k, paint in enumerate(_PAINTERS.values())
            for variant in range(VARIANTS)
        ]
    )


def _pyramid(image: NDArray[np.float64]) -> NDArray[np.uint8]:
    levels = []
    while True:
        levels.append(np.round(255 * np.clip(image, 0, 1)).astype(np.uint8).ravel())
        if image.shape[0] == 1:
            return np.concatenate(levels)
        n = image.shape[0] // 2
        image = image.reshape(n, 2, n, 2).mean(axis=(1, 3))


def _noise(rng: np.random.Generator, slope: float, stretch: float = 1.0) -> NDArray[np.float64]:
    """Seamless noise with a 1/f^slope spectrum, zero mean, unit deviation; `stretch` > 1 draws it out along x."""
    fy = np.fft.fftfreq(SIZE)[:, None] * SIZE
    fx = np.fft.rfftfreq(SIZE)[None, :] * SIZE * stretch
    frequency = np.hypot(fx, fy)
    frequency[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((SIZE, SIZE))) / frequency**slope
    spectrum[0, 0] = 0.0
    noise = np.fft.irfft2(spectrum, (SIZE, SIZE))
    return np.asarray(noise / noise.std())


def _speckle(rng: np.random.Generator) -> NDArray[np.float64]:
    grains = cv2.GaussianBlur(rng.random((SIZE, SIZE)), (0, 0), 1.2, borderType=cv2.BORDER_REFLECT)
    speckle: NDArray[np.float64] = 0.5 + 0.1 * _noise(rng, 1.0) + 0.25 * ((grains > 0.62) - 1.0 * (grains < 0.38))
    return speckle


def _wood(rng: np.random.Generator) -> NDArray[np.float64]:
    rings = np.sin(2 * np.pi * (5 * _Y + 0.55 * _noise(rng, 1.8, 3.0)))
    return np.asarray(0.5 + 0.14 * rings + 0.1 * _noise(rng, 0.8, 9.0))


def _brick(rng: np.random.Generator) -> NDArray[np.float64]:
    x, y = _X + 0.008 * _noise(rng, 1.6), _Y + 0.009 * _noise(rng, 1.6)
    row = np.floor(8 * y)
    column = np.floor(4 * x + 0.5 * (row % 2))
    to_joint = np.minimum(0.5 - np.abs(8 * y % 1 - 0.5), 2 * (0.5 - np.abs((4 * x + 0.5 * (row % 2)) % 1 - 0.5)))
    tone = rng.random((8, 4))[row.astype(int) % 8, column.astype(int) % 4]
    joint = np.clip((to_joint - 0.06) / 0.1, 0, 1)
    return np.asarray(0.78 - joint * (0.32 + 0.22 * tone) + 0.05 * _noise(rng, 0.6))


def _stone(rng: np.random.Generator) -> NDArray[np.float64]:
    """Cells around 70 wrapped random points; mortar where the nearest two are as far away as each other."""
    points = rng.random((70, 2))
    dx, dy = np.abs(_X[..., None] - points[:, 0]), np.abs(_Y[..., None] - points[:, 1])
    distance = np.hypot(np.minimum(dx, 1 - dx), np.minimum(dy, 1 - dy))
    nearest = np.partition(distance, 1, axis=2)[..., :2]
    tone = 0.35 + 0.3 * rng.random(70)[distance.argmin(axis=2)]
    border = nearest[..., 1] - nearest[..., 0]
    return np.asarray(tone + (0.8 - tone) * np.exp(-((border / 0.012) ** 2)) + 0.06 * _noise(rng, 0.8))


def _marble(rng: np.random.Generator) -> NDArray[np.float64]:
    vein = np.abs(np.sin(np.pi * (_X + _Y) * 2 + 1.4 * _noise(rng, 1.5)))
    return np.asarray(0.62 - 0.3 * (1 - vein) ** 3 + 0.06 * _noise(rng, 1.0))


def _blobs(rng: np.random.Generator) -> NDArray[np.float64]:
    image = np.full((SIZE, SIZE), 0.5) + 0.1 * _noise(rng, 2.0)
    for _ in range(22):
        cx, cy, radius = rng.random(), rng.random(), rng.uniform(0.03, 0.16)
        squash, turn = rng.uniform(0.5, 1.0), rng.uniform(0, np.pi)
        dx, dy = (_X - cx + 0.5) % 1 - 0.5, (_Y - cy + 0.5) % 1 - 0.5
        along, across = dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)
        inside = np.clip((radius - np.hypot(along, across / squash)) * SIZE / 3, 0, 1)
        image += inside * (rng.random() - image)
    return image


def _patches(rng: np.random.Generator) -> NDArray[np.float64]:
    field = _noise(rng, 1.7)
    return 0.5 + 0.16 * np.tanh(6 * field) + 0.12 * np.tanh(8 * _noise(rng, 1.5)) + 0.03 * _noise(rng, 0.4)


def _grain(first: tuple[float, float], second: tuple[float, float]) -> Callable[[np.random.Generator], Any]:
    """Two layers of noise, each given by its strength and its slope."""
    return lambda rng: 0.5 + first[0] * _noise(rng, first[1]) + second[0] * _noise(rng, second[1])


# their order is that of the bank
_PAINTERS: dict[str, Callable[[np.random.Generator], NDArray[np.float64]]] = {
    "plaster": _grain((0.14, 1.1), (0.04, 0.3)),
    "speckle": _speckle,
    "wood": _wood,
    "brick": _brick,
    "stone": _stone,
    "fabric": _grain((0.1, 0.2), (0.1, 0.9)),
    "marble": _marble,
    "asphalt": _grain((0.13, 0.15), (0.1, 1.3)),
    "blobs": _blobs,
    "patches": _patches,
}

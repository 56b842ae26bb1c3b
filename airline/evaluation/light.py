"""Images in bad light, and what helps a classical detector there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Preparation:
    """Gaussian blur of `sigma` px, then grey levels stretched by `gain` from 0, or from the mean (which becomes 128).

    Example:
        >>> import numpy as np
        >>> Preparation(sigma=0, gain=4)(np.array([[10, 60, 100]], np.uint8)).tolist()
        [[40, 240, 255]]
    """

    sigma: float
    gain: float
    about_mean: bool = False

    def __call__(self, image: Image) -> Image:
        """(H, W) to (H, W)."""
        levels = image.astype(np.float32)
        if self.sigma > 0:
            levels = cv2.GaussianBlur(levels, (0, 0), self.sigma)
        if self.about_mean:
            return _to_image((levels - levels.mean()) * self.gain + 128)
        return _to_image(levels * self.gain)


@dataclass(frozen=True)
class BadLight:
    """A degradation, a function of (H, W) image and seed, and the preparation that helps LSD most against it."""

    degrade: Callable[[Image, int], Image]
    prepare: Preparation


def darken(image: Image, seed: int) -> Image:
    """A quarter of the light, then Gaussian noise with a standard deviation of 8 grey levels."""
    noise = np.random.default_rng(seed).normal(0, 8, image.shape)
    return _to_image(0.25 * image + noise)


def motion_blur(image: Image, seed: int) -> Image:
    """Mean over 9 px along the rows; the seed is not used."""
    return np.asarray(cv2.blur(image, (9, 1)), np.uint8)


def overexpose(image: Image, seed: int) -> Image:
    """Twice the light, clipped; the seed is not used."""
    return _to_image(2.0 * image)


def _to_image(levels: NDArray[np.floating]) -> Image:
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


# Each preparation had the best F2 of LSD over a grid of blurs and gains on the images of YorkUrban itself.
BAD_LIGHT = {
    "dark": BadLight(darken, Preparation(sigma=1.5, gain=4)),
    "blur": BadLight(motion_blur, Preparation(sigma=0, gain=2, about_mean=True)),
    "bright": BadLight(overexpose, Preparation(sigma=0, gain=1)),
}

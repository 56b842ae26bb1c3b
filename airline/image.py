"""Images as people have them, to the grey image the detector works on."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from airline.errors import InputError

Gray = NDArray[np.uint8] | NDArray[np.uint16]


def to_gray(image: ArrayLike) -> Gray:
    """Check an image and reduce it to luminance.

    Args:
        image: (H, W), (H, W, 1), (H, W, 3) BGR or (H, W, 4) BGRA; uint8 or uint16.

    Returns:
        (H, W) C-contiguous array of the same dtype; raises InputError for other arrays and for no pixels.
    """
    array = np.asarray(image)
    if array.dtype not in (np.uint8, np.uint16):
        raise InputError(f"image has dtype {array.dtype}: convert it to uint8 or uint16")
    if array.size == 0 or array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] not in (1, 3, 4)):
        raise InputError(f"image has shape {array.shape}: give (H, W) grey, (H, W, 3) BGR or (H, W, 4) BGRA")
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if array.ndim == 3:
        code = cv2.COLOR_BGR2GRAY if array.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
        array = cv2.cvtColor(np.ascontiguousarray(array), code)
    return np.ascontiguousarray(array)


def mean_and_deviation(gray: Gray) -> tuple[float, float]:
    """Mean and standard deviation of the grey levels."""
    mean, deviation = cv2.meanStdDev(gray)
    return float(mean[0, 0]), float(deviation[0, 0])


def to_uint8(gray: Gray) -> NDArray[np.uint8]:
    """The 8-bit version of an image; 16 bits are stretched between the 0.5 and 99.5 percentiles of every 4th pixel."""
    if gray.dtype == np.uint8:
        return gray.astype(np.uint8, copy=False)
    low, high = np.percentile(gray[::4, ::4], (0.5, 99.5))
    scaled = (gray - np.float32(low)) * np.float32(255 / max(high - low, 1.0))
    stretched: NDArray[np.uint8] = np.clip(scaled, 0, 255).astype(np.uint8)
    return stretched

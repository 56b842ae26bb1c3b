"""Pictures that carry their number and which way is up."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

_BITS = 8


def numbered(number: int, grey: bool = False) -> np.ndarray:
    """(48, 96[, 3]) uint8: the number's bits along the top, the rest dark."""
    image = np.full((48, 96, 3), 40, np.uint8)
    for bit in range(_BITS):
        if number >> bit & 1:
            image[4:20, 12 * bit + 2 : 12 * bit + 10] = 220
    image[40:46, 4:10] = 250  # a corner at the bottom left
    return image[:, :, 0] if grey else image


def number_of(image: np.ndarray) -> int:
    """The number in a picture, which must be upright."""
    grey = image if image.ndim == 2 else image[:, :, 1]
    assert grey.shape == (48, 96)
    high = grey.max() / 2
    assert grey[43, 7] > high, "not upright"
    assert grey[43, 88] < high
    assert grey[4, 7] < high or grey[12, 7] > high
    return sum(int(grey[12, 12 * bit + 6] > high) << bit for bit in range(_BITS))


def write_numbered(folder: Path, names: list[str], grey: bool = False) -> Path:
    """Pictures of the numbers from 0 in files of these names."""
    for number, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), numbered(number, grey))
    return folder

"""16-bit images of a stream to 8 bits without flicker."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_PERCENTILES = (0.5, 99.5)
_MARGIN = 0.1
_MOST_OUTSIDE = 0.05
_LEAST_USED = 0.5
_RATE = 0.2
_REACHED = 0.02


class SteadyScale:
    """Maps the images of one stream from uint16 to uint8.

    The first image is stretched between its 0.5 and 99.5 percentiles, as `airline.image.to_uint8` does, and the
    following ones by the same two values. They change only when the scene leaves them: when more than 5 % of an image
    lie outside by more than a tenth of the range, or its own percentiles span less than half of the range. Then both
    values move by a fifth of the way to the image's percentiles, image by image, until they are within 2 % of them. An
    image of one value tells no range: it changes nothing, and where it was the first, the next counts as the first.
    """

    def __init__(self) -> None:
        self._range: NDArray[np.float64] | None = None
        self._moves = False

    def __call__(self, image: NDArray[np.uint16]) -> NDArray[np.uint8]:
        """The image, (H, W) or (H, W, 3), in 8 bits."""
        self._follow(image[::4, ::4])
        assert self._range is not None
        low, high = self._range
        above: NDArray[np.uint16] = cv2.subtract(image, float(round(low)))  # stops at zero
        scaled: NDArray[np.uint8] = cv2.convertScaleAbs(above, alpha=255 / max(high - low, 1.0))
        return scaled

    def _follow(self, sample: NDArray[np.uint16]) -> None:
        own = np.percentile(sample, _PERCENTILES)
        if self._range is None or self._range[0] == self._range[1]:
            self._range = own
        if own[0] == own[1]:
            return
        low, high = self._range
        span = high - low
        margin = _MARGIN * span
        outside = np.count_nonzero(sample < low - margin) + np.count_nonzero(sample > high + margin)
        if outside > _MOST_OUTSIDE * sample.size or own[1] - own[0] < _LEAST_USED * span:
            self._moves = True
        if self._moves:
            self._range = self._range + _RATE * (own - self._range)
            self._moves = bool(np.abs(own - self._range).max() > _REACHED * span)

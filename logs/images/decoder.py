"""From the records of one topic to 8-bit images."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.sources.reading import Image
from logs.images.encoded import decode_encoded
from logs.images.pixels import decode_pixels
from logs.messages.types import EncodedImage, RawImage, VideoPacket

if TYPE_CHECKING:
    from logs.images.video import VideoDecoder


def decode_still(record: RawImage | EncodedImage) -> Image:
    """The image of one record, from any thread; see `decode_pixels` and `decode_encoded`.

    Raises:
        UndecodableError: the record has no image that can be decoded.
    """
    return decode_pixels(record) if isinstance(record, RawImage) else decode_encoded(record.data)


class ImageDecoder:
    """Decodes one topic, message by message.

    Stills may instead be decoded in several threads by `decode_still`, and then taken through `eight_bits` in order.
    """

    def __init__(self) -> None:
        self._scale = SteadyScale()
        self._video: VideoDecoder | None = None

    def decode(self, record: RawImage | EncodedImage | VideoPacket) -> list[tuple[int, NDArray[np.uint8]]]:
        """Decode one record.

        Returns:
            (stamp in ns, (H, W) or (H, W, 3) BGR image): one for a still; for a video packet see `VideoDecoder.feed`.

        Raises:
            UndecodableError: no image comes of this record; the next may be decoded all the same.
        """
        if not isinstance(record, VideoPacket):
            return [(record.stamp_ns, self.eight_bits(decode_still(record)))]
        if self._video is None:
            from logs.images.video import VideoDecoder  # FFmpeg takes time to import

            self._video = VideoDecoder()
        return self._video.feed(record)

    def eight_bits(self, image: Image) -> NDArray[np.uint8]:
        """The image itself, or the 8-bit version of a 16-bit one on the topic's steady scale."""
        if image.dtype == np.uint8:
            return cast("NDArray[np.uint8]", image)
        return self._scale(cast("NDArray[np.uint16]", image))

    def flush(self) -> list[tuple[int, NDArray[np.uint8]]]:
        """The images a video still holds back."""
        return self._video.flush() if self._video else []


class SteadyScale:
    """Maps the images of one stream from uint16 to uint8.

    The first image is stretched between its 0.5 and 99.5 percentiles, as `airline.image.to_uint8` does, and the
    following ones by the same two values, until the scene leaves them: more than 5 % of an image lie outside by more
    than a tenth of the range, or its own percentiles span less than half of it. Then both values move by a fifth of the
    way to the image's percentiles, image by image, until they are within 2 %. An image of one value tells no range.
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
        own = np.percentile(sample, (0.5, 99.5))
        if self._range is None or self._range[0] == self._range[1]:
            self._range = own
        if own[0] == own[1]:
            return
        low, high = self._range
        span = high - low
        outside = np.count_nonzero((sample < low - 0.1 * span) | (sample > high + 0.1 * span))
        if outside > 0.05 * sample.size or own[1] - own[0] < 0.5 * span:
            self._moves = True
        if self._moves:
            self._range = self._range + 0.2 * (own - self._range)
            self._moves = bool(np.abs(own - self._range).max() > 0.02 * span)

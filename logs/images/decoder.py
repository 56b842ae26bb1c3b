"""From the records of one topic to 8-bit images."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from frontend.sources.opencv import Image
from logs.images.encoded import decode_encoded
from logs.images.pixels import decode_pixels
from logs.images.sixteen_bits import SteadyScale
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

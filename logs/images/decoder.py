"""From the records of one topic to 8-bit images.

Uncompressed ones are rows of pixels in the encodings of ROS and Foxglove:
https://docs.ros.org/en/rolling/p/sensor_msgs/ (image_encodings.hpp), https://docs.foxglove.dev/docs/sdk/schemas/raw-image
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.sources.orientation import upright
from frontend.sources.reading import Image, UndecodableError
from frontend.sources.stills import Header, Still, read_still
from logs.messages.types import BAYER, EncodedImage, RawImage, VideoPacket

if TYPE_CHECKING:
    from logs.images.video import Shown, VideoDecoder


class _Layout(NamedTuple):
    """Bytes per channel, channels per pixel, and OpenCV's conversion to BGR where one is needed."""

    depth: int
    channels: int
    conversion: int | None = None


_LAYOUTS = {
    "mono8": _Layout(1, 1),
    "8UC1": _Layout(1, 1),
    "mono16": _Layout(2, 1),
    "16UC1": _Layout(2, 1),
    "8UC2": _Layout(1, 2),
    "bgr8": _Layout(1, 3),
    "8UC3": _Layout(1, 3),
    "rgb8": _Layout(1, 3, cv2.COLOR_RGB2BGR),
    "bgra8": _Layout(1, 4, cv2.COLOR_BGRA2BGR),
    "8UC4": _Layout(1, 4, cv2.COLOR_BGRA2BGR),
    "rgba8": _Layout(1, 4, cv2.COLOR_RGBA2BGR),
    "bgr16": _Layout(2, 3),
    "16UC3": _Layout(2, 3),
    "rgb16": _Layout(2, 3, cv2.COLOR_RGB2BGR),
    "bgra16": _Layout(2, 4, cv2.COLOR_BGRA2BGR),
    "16UC4": _Layout(2, 4, cv2.COLOR_BGRA2BGR),
    "rgba16": _Layout(2, 4, cv2.COLOR_RGBA2BGR),
    # OpenCV has two names for each pattern: this order as in RGGB, and an older one of two letters that begins at the
    # pixel (1, 1), by which RGGB is BG.
    **{name: _Layout(int(name[10:]) // 8, 1, getattr(cv2, f"COLOR_Bayer{name[6:10].upper()}2BGR")) for name in BAYER},
    "yuv422": _Layout(1, 2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": _Layout(1, 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": _Layout(1, 2, cv2.COLOR_YUV2BGR_YUYV),
    "yuyv": _Layout(1, 2, cv2.COLOR_YUV2BGR_YUYV),
}
# A plane of luminance, then one of interleaved colour differences at half the resolution.
_TWO_PLANES = {"nv12": cv2.COLOR_YUV2BGR_NV12, "nv21": cv2.COLOR_YUV2BGR_NV21}
_SMALLEST_BAYER = 3  # px; OpenCV leaves smaller images black


def decode_pixels(raw: RawImage) -> Image:
    """The image in rows of `step` bytes, 0 for rows without padding; the last row may end with its pixels.

    Returns:
        (H, W) or (H, W, 3) BGR, uint8 or native uint16, C-contiguous, a copy.

    Raises:
        UndecodableError: an encoding that is not readable, or sizes that contradict each other.
    """
    if raw.encoding in _TWO_PLANES:
        return _from_two_planes(raw)
    layout = _LAYOUTS.get(raw.encoding)
    if layout is None:
        raise UndecodableError("image encoding is not readable", repr(raw.encoding[:40]))
    pixels = _rows(raw, layout)
    if raw.encoding == "8UC2":  # grey and something, or YUYV
        pixels = pixels[:, :, 0]
    if layout.conversion is None or layout.depth == 2:
        pixels = cast("Image", pixels.astype(pixels.dtype.newbyteorder("="), order="C"))
    if layout.conversion is None:
        return pixels
    if (layout.channels == 2 and raw.width % 2) or (
        layout.channels == 1 and min(raw.width, raw.height) < _SMALLEST_BAYER
    ):
        raise _contradiction(raw)
    return cast("Image", cv2.cvtColor(pixels, layout.conversion))


def _rows(raw: RawImage, layout: _Layout) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """A view of the pixels without the padding."""
    size = layout.depth * layout.channels
    step = raw.step or raw.width * size
    _check(raw, raw.width * size, step, raw.height)
    shape: tuple[int, ...] = (raw.height, raw.width)
    strides: tuple[int, ...] = (step, size)
    if layout.channels > 1:
        shape, strides = (*shape, layout.channels), (*strides, layout.depth)
    kind = np.dtype(np.uint8 if layout.depth == 1 else np.uint16).newbyteorder(">" if raw.big_endian else "<")
    return np.ndarray(shape, kind, raw.data, strides=strides)


def _from_two_planes(raw: RawImage) -> NDArray[np.uint8]:
    step = raw.step or raw.width
    _check(raw, raw.width, step, raw.height + raw.height // 2)
    if raw.width % 2 or raw.height % 2:
        raise _contradiction(raw)
    luminance = np.ndarray((raw.height, raw.width), np.uint8, raw.data, strides=(step, 1))
    half = (raw.height // 2, raw.width // 2, 2)
    colour = np.ndarray(half, np.uint8, raw.data, offset=raw.height * step, strides=(step, 2, 1))
    image: NDArray[np.uint8] = cv2.cvtColorTwoPlane(luminance, colour, _TWO_PLANES[raw.encoding])
    return image


def _check(raw: RawImage, row: int, step: int, rows: int) -> None:
    """Whether the data hold so many rows; nothing is allocated before."""
    if raw.width < 1 or raw.height < 1 or step < row or (rows - 1) * step + row > len(raw.data):
        raise _contradiction(raw)


def _contradiction(raw: RawImage) -> UndecodableError:
    claim = f"{raw.width}x{raw.height} {raw.encoding} with {raw.step} bytes per row"
    return UndecodableError("image size contradicts its data", f"{len(raw.data)} bytes are no {claim}")


def decode_still(record: RawImage | EncodedImage, autorotate: bool = True) -> Still:
    """The image of one record, from any thread; see `decode_pixels` and `read_still`.

    A file with one channel whose message says that it is a Bayer mosaic is made a colour image, as a raw one is.
    """
    if isinstance(record, RawImage):
        return Still(decode_pixels(record), Header(record.encoding))
    image, header = read_still(record.data, autorotate=False, only=True)
    if record.encoding in BAYER and image.ndim == 2 and min(image.shape) >= _SMALLEST_BAYER:
        conversion = _LAYOUTS[record.encoding].conversion
        assert conversion is not None
        image = cast("Image", cv2.cvtColor(image, conversion))
    return Still(upright(image, header.exif) if autorotate else image, header)


class ImageDecoder:
    """Decodes one topic, message by message; or `decode_still` does in threads, and `eight_bits` in order."""

    def __init__(self) -> None:
        self._scale = SteadyScale()
        self._video: VideoDecoder | None = None

    @property
    def video(self) -> VideoDecoder:
        if self._video is None:
            from logs.images.video import VideoDecoder  # FFmpeg takes time to import

            self._video = VideoDecoder()
        return self._video

    def decode(self, record: RawImage | EncodedImage | VideoPacket) -> list[NDArray[np.uint8]]:
        """(H, W) or (H, W, 3) BGR image of a still; those that come of a video packet, see `VideoDecoder.feed`.

        Raises:
            UndecodableError: no image comes of this record; the next may be decoded all the same.
        """
        if isinstance(record, VideoPacket):
            return [shown.image for shown in self.video.feed(record)]
        return [self.eight_bits(decode_still(record).image)]

    def eight_bits(self, image: Image) -> NDArray[np.uint8]:
        """The image itself, or the 8-bit version of a 16-bit one on the topic's steady scale."""
        if image.dtype == np.uint8:
            return cast("NDArray[np.uint8]", image)
        return self._scale(cast("NDArray[np.uint16]", image))

    @property
    def reorders(self) -> bool:
        """See `VideoDecoder`."""
        return self._video is not None and self._video.reorders

    def flush(self) -> list[Shown]:
        """The images a video still holds back."""
        return self._video.flush() if self._video else []


class SteadyScale:
    """Maps the images of one stream from uint16 to uint8.

    The first is stretched between its 0.5 and 99.5 percentiles, as `airline.image.to_uint8` does, the others by the
    same two values until the scene leaves them: more than 5 % of an image lie outside by more than a tenth of the
    range, or its percentiles span less than half of it. Then both values move by a fifth of the way to the image's
    percentiles, image by image, until they are within 2 %. An image of one value tells no range.
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

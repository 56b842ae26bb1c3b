"""Uncompressed images: rows of pixels in the encodings of ROS and Foxglove.

https://docs.ros.org/en/rolling/p/sensor_msgs/ (image_encodings.hpp), https://docs.foxglove.dev/docs/sdk/schemas/raw-image
"""

from __future__ import annotations

from typing import NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.sources.reading import Image
from logs.messages.types import RawImage, UndecodableError


class _Layout(NamedTuple):
    """Bytes per channel, channels per pixel, and OpenCV's conversion to BGR where one is needed."""

    depth: int
    channels: int
    conversion: int | None = None


# Bayer patterns are named here, as in ROS, by the top-left four pixels in reading order. OpenCV has two names for each:
# this order as in RGGB, and an older one of two letters that begins at the pixel (1, 1), by which RGGB is BG.
_LAYOUTS = {
    "mono8": _Layout(1, 1),
    "8UC1": _Layout(1, 1),
    "mono16": _Layout(2, 1),
    "16UC1": _Layout(2, 1),
    "bgr8": _Layout(1, 3),
    "8UC3": _Layout(1, 3),
    "rgb8": _Layout(1, 3, cv2.COLOR_RGB2BGR),
    "bgra8": _Layout(1, 4, cv2.COLOR_BGRA2BGR),
    "8UC4": _Layout(1, 4, cv2.COLOR_BGRA2BGR),
    "rgba8": _Layout(1, 4, cv2.COLOR_RGBA2BGR),
    "bayer_rggb8": _Layout(1, 1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": _Layout(1, 1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": _Layout(1, 1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": _Layout(1, 1, cv2.COLOR_BayerGRBG2BGR),
    "yuv422": _Layout(1, 2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": _Layout(1, 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": _Layout(1, 2, cv2.COLOR_YUV2BGR_YUYV),
    "yuyv": _Layout(1, 2, cv2.COLOR_YUV2BGR_YUYV),
}
# A plane of luminance, then one of interleaved colour differences at half the resolution.
_TWO_PLANES = {"nv12": cv2.COLOR_YUV2BGR_NV12, "nv21": cv2.COLOR_YUV2BGR_NV21}
_SMALLEST_BAYER = 3  # px; OpenCV leaves smaller images black


def decode_pixels(raw: RawImage) -> Image:
    """The image in an uncompressed message.

    Args:
        raw: rows of `step` bytes, of which the pixels are the first; 0 for rows without padding. The last row may end
            with its pixels.

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
    if layout.conversion is None:
        return cast("Image", pixels.astype(pixels.dtype.newbyteorder("="), order="C"))
    even = layout.channels != 2 or raw.width % 2 == 0
    bayer = layout.channels == 1
    if not even or (bayer and min(raw.width, raw.height) < _SMALLEST_BAYER):
        raise _contradiction(raw)
    image: NDArray[np.uint8] = cv2.cvtColor(pixels, layout.conversion)
    return image


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

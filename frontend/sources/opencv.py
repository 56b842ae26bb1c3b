"""Where OpenCV needs care: its chatter on stderr, and the many shapes of what it decodes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8] | NDArray[np.uint16]

_FFMPEG_LEVEL = "OPENCV_FFMPEG_LOGLEVEL"
_AV_LOG_QUIET = "-8"


@contextmanager
def quiet() -> Iterator[None]:
    """Silence OpenCV's log inside the block, and FFmpeg's for good if the block is the first to open a video.

    OpenCV reads FFmpeg's level from the environment, at its first use only; a level the user has set is left alone.
    """
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    ours = _FFMPEG_LEVEL not in os.environ
    if ours:
        os.environ[_FFMPEG_LEVEL] = _AV_LOG_QUIET
    try:
        yield
    finally:
        if ours:
            del os.environ[_FFMPEG_LEVEL]
        cv2.utils.logging.setLogLevel(level)


def as_frame_image(pixels: NDArray[Any]) -> Image | None:
    """The array a `Frame` holds: (H, W) or (H, W, 3) BGR, uint8 or uint16, C-contiguous, without alpha.

    None for other depths (float, signed) and for empty images.
    """
    if pixels.dtype not in (np.uint8, np.uint16) or not pixels.size:
        return None
    if pixels.ndim == 3 and pixels.shape[2] < 3:
        pixels = pixels[:, :, 0]
    elif pixels.ndim == 3 and pixels.shape[2] == 4:
        return cast("Image", cv2.cvtColor(pixels, cv2.COLOR_BGRA2BGR))  # a hundred times faster than slicing
    elif pixels.ndim == 3:
        pixels = pixels[:, :, :3]
    return np.ascontiguousarray(pixels)


def decode_image(data: bytes) -> Image | None:
    """Decode an image file held in memory (PNG, JPEG, BMP, TIFF, WebP, PNM), keeping grey and 16 bits as they are.

    None for bytes that are no image, or a cut or damaged one.
    """
    try:
        with quiet():
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:  # of no bytes, too
        return None
    return None if pixels is None else as_frame_image(pixels)

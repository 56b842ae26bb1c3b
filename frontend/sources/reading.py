"""What sources share: OpenCV kept quiet, its pictures as frames hold them, and the count of what cannot be read."""

from __future__ import annotations

import logging
import os
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError

Image = NDArray[np.uint8] | NDArray[np.uint16]
Bytes = bytes | memoryview

_FFMPEG_LEVEL = "OPENCV_FFMPEG_LOGLEVEL"
_AV_LOG_QUIET = "-8"
_NAMED = 5  # reasons in a warning


class UndecodableError(InputError):
    """An image or message that cannot be used; `reason` has the same words for the same fault, to be counted by."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason


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


def read_image(capture: cv2.VideoCapture) -> tuple[int, Image] | None:
    """The next picture of a camera, stream or file, and when it came, in ns of the monotonic clock.

    None where there is none, and for a damaged one.
    """
    try:
        if not capture.grab():
            return None
        stamp_ns = time.monotonic_ns()
        ok, pixels = capture.retrieve()
    except cv2.error:  # a damaged header may ask for an impossible size
        return None
    image = as_frame_image(pixels) if ok else None
    return None if image is None else (stamp_ns, image)


class Skips:
    """Frames that could not be read: how many, which was the first, and `reasons` with counts where some were given."""

    def __init__(self, source: str) -> None:
        self.count = 0
        self.first = ""
        self.reasons: Counter[str] = Counter()
        self._source = source
        self._reported = 0

    def add(self, what: str, count: int = 1, reason: str | None = None) -> None:
        """Count frames; `what` names the first of them or says what is wrong with it."""
        self.first = self.first or what
        self.count += count
        if reason is not None:
            self.reasons[reason] += count

    def report(self, log: logging.Logger) -> None:
        """Log one warning if frames were skipped since the last report."""
        if self.count == self._reported:
            return
        self._reported = self.count
        why = ""
        if len(self.reasons) > 1:  # the first one says it otherwise
            named = [f"{count} x {reason}" for reason, count in self.reasons.most_common(_NAMED)]
            why = f" ({', '.join(named)}{', ...' if len(self.reasons) > _NAMED else ''})"
        frames = "1 frame" if self.count == 1 else f"{self.count} frames"
        log.warning("%s: skipped %s that could not be read%s; first: %s", self._source, frames, why, self.first)

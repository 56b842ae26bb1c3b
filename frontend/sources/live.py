"""Frames of a camera or a network stream, as they come."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator

import cv2

from airline.errors import InputError
from frontend.frame import Frame
from frontend.opencv import as_frame_image, quiet

_TIMEOUT_MS = 5000


class LiveSource:
    """Frames of a camera or a stream, stamped with the host's wall clock when they arrive.

    The clock is read once and then advanced by the monotonic clock, so that stamps never step back.

    Args:
        device: a camera's number, or a URL (rtsp://, http://, udp://, ...).

    Raises:
        InputError: the camera or stream cannot be opened; while iterating, it opened but sends nothing.
    """

    def __init__(self, device: int | str) -> None:
        # A URL may carry a password, which belongs in no message.
        self._title = f"camera {device}" if isinstance(device, int) else re.sub(r"//[^/@]*@", "//", device)
        with quiet():
            self._capture = _open_camera(device) if isinstance(device, int) else _open_stream(device)
        if not self._capture.isOpened():
            hint = "is it connected and free?" if isinstance(device, int) else "is the address right and reachable?"
            raise InputError(f"cannot open {self._title}: {hint}")
        self._clock_offset_ns = time.time_ns() - time.monotonic_ns()

    @property
    def name(self) -> str:
        return re.sub(r"[^\w.]+", "-", self._title.split("?")[0].split("://")[-1]).strip("-.") or "stream"

    @property
    def frame_count(self) -> int | None:
        return None

    @property
    def skipped(self) -> int:
        return 0

    @property
    def live(self) -> bool:
        """False for a recording behind a URL, which waits for who reads it."""
        return not 0 < self._capture.get(cv2.CAP_PROP_FRAME_COUNT) < 1e9

    def __iter__(self) -> Iterator[Frame]:
        index = 0
        last_ns = 0
        while self._capture.grab():
            stamp_ns = max(self._clock_offset_ns + time.monotonic_ns(), last_ns + 1)
            try:
                ok, pixels = self._capture.retrieve()
            except cv2.error:  # a damaged stream may ask for an impossible size
                break
            image = as_frame_image(pixels) if ok else None
            if image is None:
                break
            yield Frame(index, stamp_ns, image)
            index, last_ns = index + 1, stamp_ns
        if index == 0:
            raise InputError(f"{self._title} opened but sends no picture: does another program use it?")

    def close(self) -> None:
        self._capture.release()


def _open_camera(number: int) -> cv2.VideoCapture:
    # OpenCV reads 100, 200, ... as the number of a driver.
    return cv2.VideoCapture(number) if 0 <= number < 100 else cv2.VideoCapture()


def _open_stream(url: str) -> cv2.VideoCapture:
    if not url.isascii():  # OpenCV crashes on some
        return cv2.VideoCapture()
    timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _TIMEOUT_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _TIMEOUT_MS]
    return cv2.VideoCapture(url, cv2.CAP_FFMPEG, timeouts)

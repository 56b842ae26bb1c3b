"""Frames of a camera or a network stream, as they come."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Iterator

import cv2

from airline.errors import ConfigError, InputError
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.kinds import without_password
from frontend.sources.reading import Image, quiet, read_image

log = logging.getLogger(__name__)

_TIMEOUT_MS = 5000
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.25, 5.0


class LiveSource(Source):
    """Frames of a camera or a stream, stamped with the host's wall clock when they arrive; stamps never step back.

    A stream that drops, or sends nothing for five seconds, is opened again, with growing waits in between. Its frames
    go on with the next number, and the gap shows in the stamps, at which the tracker begins anew.

    Args:
        device: a camera's number or device (/dev/video0, /dev/v4l/by-id/...), or a URL (rtsp://, http://, udp://, ...).
        reconnect_s: for how many seconds after its last frame a stream is tried; 0 takes its end as the end.

    Raises:
        InputError: the camera or stream cannot be opened; while iterating, it opened but sends nothing, or was lost.
        ConfigError: no such time.
    """

    name: str
    kind: str
    live = True
    reconnects = 0

    def __init__(self, device: int | str, reconnect_s: float = 60.0) -> None:
        if not reconnect_s >= 0:
            raise ConfigError(f"a stream can be reconnected for 0 or more seconds, not {reconnect_s}")
        self._device = device
        self._reconnect_s = reconnect_s
        self._is_camera = isinstance(device, int) or "://" not in device
        self.kind = "live camera" if self._is_camera else "live stream"
        # A URL may carry a password, which belongs in no message.
        self._title = f"camera {device}" if self._is_camera else without_password(str(device))
        self._capture = _open(device)
        if not self._capture.isOpened():
            hint = "is it connected and free?" if self._is_camera else "is the address right and reachable?"
            raise InputError(f"cannot open {self._title}: {hint}")
        self.name = re.sub(r"[^\w.]+", "-", self._title.split("?")[0].split("://")[-1]).strip("-.") or "stream"
        self._clock_offset_ns = time.time_ns() - time.monotonic_ns()
        self._stopped = threading.Event()

    @property
    def is_recording(self) -> bool:
        """Whether what is behind an http URL has an end: better read by `VideoSource`, with its own times."""
        is_http = str(self._device).startswith(("http://", "https://"))
        return is_http and 0 < self._capture.get(cv2.CAP_PROP_FRAME_COUNT) < 1e9

    def __iter__(self) -> Iterator[Frame]:
        index = last_ns = 0
        while not self._stopped.is_set():
            found = read_image(self._capture) or (self._read_again() if index else None)
            if found is None:
                break
            stamp_ns, image = found
            stamp_ns = max(self._clock_offset_ns + stamp_ns, last_ns + 1)
            yield Frame(index, stamp_ns, image)
            index, last_ns = index + 1, stamp_ns
        if index == 0 and not self._stopped.is_set():
            raise InputError(f"{self._title} opened but sends no picture: does another program use it?")

    def stop(self) -> None:
        self._stopped.set()

    def close(self) -> None:
        self.stop()
        self._capture.release()

    def _read_again(self) -> tuple[int, Image] | None:
        """The first image after the stream has come back; None where its end is the end.

        Raises:
            InputError: it does not come back, or it was a camera.
        """
        if self._is_camera:
            raise InputError(f"{self._title} sends no more pictures: is it still connected?")
        if self._reconnect_s == 0:
            return None
        begin_s = time.monotonic()
        log.warning("%s: the stream was lost: trying to reconnect for %g s", self._title, self._reconnect_s)
        wait_s = _FIRST_WAIT_S
        while (left_s := self._reconnect_s - (time.monotonic() - begin_s)) > 0:
            if self._stopped.wait(min(wait_s, left_s)):
                return None
            wait_s = min(2 * wait_s, _LONGEST_WAIT_S)
            self._capture.release()
            self._capture = _open(self._device)
            found = read_image(self._capture) if self._capture.isOpened() else None
            if found is not None:
                self.reconnects += 1
                log.warning("%s: the stream is back after %.1f s", self._title, time.monotonic() - begin_s)
                return found
        raise InputError(
            f"{self._title} was lost and did not come back within {self._reconnect_s:g} s: what was done so far is "
            "kept; see whether it still sends, or wait longer by --reconnect"
        )


def _open(device: int | str) -> cv2.VideoCapture:
    with quiet():
        if isinstance(device, int):
            return cv2.VideoCapture(device) if device < 100 else cv2.VideoCapture()  # which reads 100, ... as drivers
        if "://" not in device:
            return cv2.VideoCapture(device, cv2.CAP_V4L2)
        if not device.isascii():  # OpenCV crashes on some
            return cv2.VideoCapture()
        timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _TIMEOUT_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _TIMEOUT_MS]
        return cv2.VideoCapture(device, cv2.CAP_FFMPEG, timeouts)

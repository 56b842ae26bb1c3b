"""Frames of a video file."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Iterator
from pathlib import Path

import cv2

from airline.errors import InputError
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.reading import Image, Skips, quiet, read_image

log = logging.getLogger(__name__)

_DEFAULT_FPS = 30.0
# FFmpeg reports a damaged frame as a failed read and goes on behind it, at 12 us per failed read.
_MAX_FAILED_READS = 10_000
_SPARE_READS = 16
# FFmpeg renders any text file as a video of scrolling terminal output, under this codec.
_TEXT_CODEC = int.from_bytes(b"ansi", "little")


class VideoSource(Source):
    """Frames of a video file, by OpenCV's FFmpeg.

    `Frame.stamp_ns` counts from the first readable frame and follows the container's times; where it has none, its
    frame rate. A damaged frame is skipped and keeps its number; a cut file yields what is readable.

    Args:
        path: the file.
        autorotate: turn the pictures upright as the file says.

    Raises:
        InputError: the file is missing, no video, or has no readable frame.
    """

    name: str
    frame_count: int | None
    first_stamp_ns = 0

    def __init__(self, path: str | os.PathLike[str], *, autorotate: bool = True) -> None:
        self._path = Path(path)
        self._autorotate = autorotate
        self.name = self._path.stem
        self._skips = Skips(self.name)
        self._capture = _open(self._path)
        self._position = 0  # frames passed, damaged ones included
        self._origin_ms = 0.0
        self._last: tuple[int, int] | None = None  # index and stamp of the latest frame
        self._start_ns = 0
        stated = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self.frame_count = int(stated) if 0 < stated < 1e9 else None  # what the container says
        fps = self._capture.get(cv2.CAP_PROP_FPS)
        self._fps = fps if math.isfinite(fps) and 0 < fps < 1e4 else _DEFAULT_FPS
        is_text = int(self._capture.get(cv2.CAP_PROP_FOURCC)) == _TEXT_CODEC
        first = None if is_text else self._read()
        if first is None:
            self.close()
            raise InputError(f"'{self._path}' holds no readable video frame: give a video file")
        self._origin_ms, self._first_image = first

    @property
    def skipped(self) -> int:
        return self._skips.count

    def seek(self, start_s: float) -> None:
        """See `Source`. Behind it `Frame.index` is the time multiplied by the frame rate: exact for a constant rate."""
        self._start_ns = round(start_s * 1e9)

    def __iter__(self) -> Iterator[Frame]:
        try:
            found = (self._origin_ms, self._first_image) if self._start_ns <= 0 else self._read_near(self._start_ns)
            while found is not None:
                frame = self._frame(*found)
                if frame.stamp_ns >= self._start_ns:
                    yield frame
                found = self._read()
            self._count_lost_tail()
        finally:
            self._skips.report(log)

    def close(self) -> None:
        self._capture.release()

    def _read(self) -> tuple[float, Image] | None:
        """The next readable frame and its container time in ms; failed reads before it were damaged frames."""
        left = max((self.frame_count or 0) - self._position, 0) + _SPARE_READS
        for failed in range(min(left, _MAX_FAILED_READS)):
            found = self._try_read()
            if found is not None:
                if failed:
                    self._skips.add(f"frame {self._position}", failed)
                self._position += failed + 1
                return found
        return None

    def _try_read(self) -> tuple[float, Image] | None:
        found = read_image(self._capture)
        return found and (self._capture.get(cv2.CAP_PROP_POS_MSEC), found[1])

    def _frame(self, time_ms: float, image: Image) -> Frame:
        """Number and stamp a frame; a time that does not advance is replaced by the frame rate's."""
        index = self._position - 1
        stamp = round((time_ms - self._origin_ms) * 1e6) if math.isfinite(time_ms) else 0
        if self._last is not None and stamp <= self._last[1]:
            stamp = self._last[1] + round((index - self._last[0]) * 1e9 / self._fps)
        self._last = index, stamp
        return Frame(index, stamp, image)

    def _read_near(self, start_ns: int) -> tuple[float, Image] | None:
        """A frame at or shortly before start_ns, in the last resort the first.

        OpenCV seeks by the mean frame rate, which misses where the rate varies or frames are damaged.
        """
        back_ms = 0.0
        while (target_ms := start_ns / 1e6 - back_ms) > 0:
            self._capture.set(cv2.CAP_PROP_POS_MSEC, self._origin_ms + target_ms)
            found = self._try_read()
            if found is not None and 0 < (elapsed_ms := found[0] - self._origin_ms) <= start_ns / 1e6:
                self._position = round(elapsed_ms * self._fps / 1000) + 1
                return found
            back_ms = 2 * back_ms + 1000
        self._capture.release()
        self._capture = _open(self._path)
        self._position = 0
        return self._read()

    def _count_lost_tail(self) -> None:
        """Count the frames that the container states behind the last readable one.

        With a slack, for trimmed files count hidden frames, and only where time is missing too, for some containers
        state their duration times the highest frame rate.
        """
        stated = self.frame_count or 0
        seconds = 0.0 if self._last is None else self._last[1] / 1e9
        lost = min(stated - self._position, round(stated - 1 - seconds * self._fps))
        if lost > 1 + 0.02 * stated:
            self._skips.add(f"frame {self._position}, where the file ends", lost)


def _open(path: Path) -> cv2.VideoCapture:
    if os.path.isdir(path):  # noqa: PTH112  pathlib raises for a name that is too long
        raise InputError(f"'{path}' is a folder, not a video file")
    if not os.path.isfile(path):  # noqa: PTH113
        raise InputError(f"there is no video file '{path}'")
    # Absolute, so that FFmpeg takes no part of the name for a protocol.
    name = str(path.absolute())
    try:
        name.encode()  # OpenCV crashes on names that are not UTF-8
    except UnicodeEncodeError:
        raise InputError(f"the file name {name!a} is not UTF-8: rename the file") from None
    with quiet():
        capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise InputError(f"'{path}' is no video that can be read: it is empty, cut short or of an unknown format")
    return capture

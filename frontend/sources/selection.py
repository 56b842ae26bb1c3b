"""A part of a stream: from when to when, every how many frames, at which size."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

from airline.errors import ConfigError
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.wrapped import WrappedSource

_SIZES = range(16, 16385)


@runtime_checkable
class SeekableSource(Source, Protocol):
    """A source that can begin later without decoding all that comes before."""

    @property
    def first_stamp_ns(self) -> int:
        """Stamp of the stream's first frame, ns; the same before and after a seek."""
        ...

    def seek(self, start_s: float) -> None:
        """Begin iteration with the first frame at or after start_s seconds since the first frame."""
        ...


def select_frames(
    source: Source,
    *,
    start_s: float | None = None,
    end_s: float | None = None,
    stride: int = 1,
    max_frames: int | None = None,
    resize: tuple[int, int | None] | None = None,
) -> Source:
    """A source that yields a part of another one. Frames keep their index and stamp.

    Args:
        source: the stream; closing the selection closes it.
        start_s, end_s: seconds since the stream's first frame; start is included, end is not.
        stride: keep the first frame from start_s on and every stride-th after it.
        max_frames: yield at most so many frames.
        resize: (width, height) px, or (width, None) to keep the aspect ratio; `Frame.camera` is scaled along.

    Raises:
        ConfigError: a value is impossible.
    """
    start = 0.0 if start_s is None else start_s
    if not (math.isfinite(start) and start >= 0):
        raise ConfigError(f"start must be zero or more seconds, not {start_s}")
    if end_s is not None and not (math.isfinite(end_s) and end_s > start):
        raise ConfigError(f"end must be later than start ({start:g} s), not {end_s}")
    if stride < 1:
        raise ConfigError(f"stride must be 1 or more, not {stride}")
    if max_frames is not None and max_frames < 1:
        raise ConfigError(f"the number of frames must be 1 or more, not {max_frames}")
    if resize is not None and any(size is not None and size not in _SIZES for size in resize):
        raise ConfigError(f"a frame can be resized to between {_SIZES[0]} and {_SIZES[-1]} px, not {resize}")
    if start > 0 and isinstance(source, SeekableSource):
        source.seek(start)
    end_ns = None if end_s is None else round(end_s * 1e9)
    return _Selection(source, round(start * 1e9), end_ns, stride, max_frames, resize)


class _Selection(WrappedSource):
    def __init__(
        self,
        source: Source,
        start_ns: int,
        end_ns: int | None,
        stride: int,
        max_frames: int | None,
        resize: tuple[int, int | None] | None,
    ) -> None:
        super().__init__(source)
        self._start_ns, self._end_ns = start_ns, end_ns
        self._stride, self._max_frames, self._resize = stride, max_frames, resize

    @property
    def frame_count(self) -> int | None:
        count = self._source.frame_count
        if count is None:
            return self._max_frames
        count = math.ceil(count / self._stride)
        return count if self._max_frames is None else min(count, self._max_frames)

    def __iter__(self) -> Iterator[Frame]:
        yielded = 0
        for position, frame in enumerate(self._between()):
            if position % self._stride:
                continue
            yield frame if self._resize is None else _resized(frame, *self._resize)
            yielded += 1
            if yielded == self._max_frames:  # before a live source is asked for one more
                return

    def _between(self) -> Iterator[Frame]:
        origin = self._source.first_stamp_ns if isinstance(self._source, SeekableSource) else None
        for frame in self._source:
            origin = frame.stamp_ns if origin is None else origin
            elapsed = frame.stamp_ns - origin
            if self._end_ns is not None and elapsed >= self._end_ns:
                return
            if elapsed >= self._start_ns:
                yield frame


def _resized(frame: Frame, width: int, height: int | None) -> Frame:
    import cv2

    rows, columns = frame.image.shape[:2]
    if height is None:
        height = max(1, round(rows * width / columns))
    if (columns, rows) == (width, height):
        return frame
    image: Any = cv2.resize(frame.image, (width, height), interpolation=cv2.INTER_AREA)
    return replace(frame, image=image, camera=frame.camera and frame.camera.scaled(width, height))

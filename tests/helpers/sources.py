"""Sources of frames that are in a list."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from frontend.frame import Frame
from frontend.protocols import Source


@dataclass
class Listed(Source):
    """Frames of a list, then perhaps an error; `read` counts how many were taken from it."""

    frames: list[Frame]
    endless: bool = False
    error: BaseException | None = None
    read: int = 0
    closed: bool = False
    name: str = "listed"
    skipped: int = 0
    start_s: float = 0.0
    cost_s: float = 0.0  # of reading a frame

    @property
    def frame_count(self) -> int | None:
        return None if self.endless else len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        for frame in self.frames:
            if not self.start_s or frame.stamp_ns - self.frames[0].stamp_ns >= round(self.start_s * 1e9):
                time.sleep(self.cost_s)
                self.read += 1
                yield frame
        if self.error is not None:
            raise self.error

    def close(self) -> None:
        self.closed = True


class Seekable(Listed):
    """The same, which knows where to begin."""

    @property
    def first_stamp_ns(self) -> int:
        return self.frames[0].stamp_ns

    def seek(self, start_s: float) -> None:
        self.start_s = start_s

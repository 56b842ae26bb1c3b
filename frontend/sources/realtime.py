"""A recording played at the pace of its stamps, as if a camera took it now."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.wrapped import WrappedSource


class RealtimeSource(WrappedSource):
    """Gives out each frame when it is due: as long after the first one as their stamps say.

    Its frames come whether or not somebody takes them, as those of a camera do: `FreshFrames` drops the oldest when the
    consumer is slower. Who iterates without it misses no frame and gets the late ones at once. The clock starts when
    the second frame is asked for, so that preparing with the first one takes nothing from the clip.

    Args:
        source: the recording; closing this closes it.
        ahead: read all of it before the first frame, for a source that is slower than its own stamps. All frames are
            in memory then.
    """

    live = True

    def __init__(self, source: Source, *, ahead: bool = False) -> None:
        super().__init__(source)
        self._ahead = ahead
        self._stopped = threading.Event()

    def __iter__(self) -> Iterator[Frame]:
        frames = iter(self._read() if self._ahead else self._source)
        first = next(frames, None)
        if first is None:
            return
        yield first
        begin_s = time.perf_counter()
        for frame in frames:
            due_s = begin_s + (frame.stamp_ns - first.stamp_ns) / 1e9
            if self._stopped.wait(max(0.0, due_s - time.perf_counter())):
                return
            yield frame

    def stop(self) -> None:
        """End the iteration, whose thread may be waiting for the next frame; it may go on reading the one at hand."""
        self._stopped.set()

    def _read(self) -> list[Frame]:
        """All frames, or those until it is stopped."""
        frames = []
        for frame in self._source:
            frames.append(frame)
            if self._stopped.is_set():
                break
        return frames

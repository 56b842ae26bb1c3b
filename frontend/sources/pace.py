"""Frames that wait for nobody: a recording played at its own pace, and of a live source always the newest ones."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.wrapped import WrappedSource

log = logging.getLogger(__name__)

MAX_LATENCY_S = 0.2
_WAITING = 2  # frames; one more would only be older


class RealtimeSource(WrappedSource):
    """A recording that gives out each frame when it is due: as long after the first one as their stamps say.

    It is live like a camera: `FreshFrames` drops the oldest frames when the consumer is slower; without that the late
    ones come at once. The clock starts when the second frame is asked for: preparing with the first one costs nothing.

    Args:
        source: the recording.
    """

    live = True

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self._stopped = threading.Event()

    def __iter__(self) -> Iterator[Frame]:
        frames = iter(self._source)
        first = next(frames, None)
        if first is None:
            return
        yield replace(first, read_s=time.perf_counter())
        begin_s = time.perf_counter()
        for frame in frames:
            due_s = begin_s + (frame.stamp_ns - first.stamp_ns) / 1e9
            if self._stopped.wait(max(0.0, due_s - time.perf_counter())):
                return
            yield replace(frame, read_s=time.perf_counter())

    def stop(self) -> None:
        self._stopped.set()


class FreshFrames(WrappedSource):
    """A live source that never makes its device wait: a thread reads, and the oldest of the waiting frames are dropped.

    Frames keep their index, so that gaps show; the first one that is dropped costs a warning. A recording waits until
    the second frame is asked for.

    Args:
        source: the live source.
        max_latency_s: a frame that has waited longer, in seconds, is dropped.
        prepares: whether the consumer warms up with the first frame: then frames dropped until it asks for the second
            are not counted.
    """

    def __init__(self, source: Source, max_latency_s: float = MAX_LATENCY_S, *, prepares: bool = False) -> None:
        super().__init__(source)
        self._max_latency_s = max_latency_s
        self._prepares = prepares
        self._waiting: deque[Frame] = deque()
        self._changed = threading.Condition()
        self._asked = 0  # frames
        self._dropped = 0
        self._stopped = False
        self._error: BaseException | None = None
        self._reader = threading.Thread(target=self._read, name="live source")

    @property
    def dropped(self) -> int:
        return self._dropped + self._source.dropped  # of a pair's cameras each drops its own

    def __iter__(self) -> Iterator[Frame]:
        self._reader.start()
        try:
            while (frame := self._take()) is not None:
                yield frame
        finally:
            if self.dropped:
                log.info("%s: dropped %d frames", self.name, self.dropped)
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """End reading as soon as the frame at hand is read, and the iteration with the frames that are waiting."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        super().stop()

    def close(self) -> None:
        self.stop()
        if self._reader.ident is not None:
            self._reader.join()
        self._source.close()

    def _read(self) -> None:
        begun = not isinstance(self._source, RealtimeSource)
        try:
            for frame in self._source:
                with self._changed:
                    # a program that ends without closing waits for its threads
                    if self._stopped or not threading.main_thread().is_alive():
                        return
                    if len(self._waiting) == _WAITING:
                        self._drop()
                    self._waiting.append(replace(frame, read_s=time.perf_counter()))
                    self._changed.notify_all()
                    self._changed.wait_for(lambda: self._stopped or begun or self._asked > 1)
        except BaseException as error:
            self._error = error  # raised behind the frames that still wait
        finally:
            with self._changed:
                self._stopped = True
                self._changed.notify_all()

    def _take(self) -> Frame | None:
        """The oldest frame that is not too old; None when there will be no more."""
        with self._changed:
            self._asked += 1
            self._changed.notify_all()
            while True:
                self._changed.wait_for(lambda: self._waiting or self._stopped)
                oldest_s = time.perf_counter() - self._max_latency_s
                while self._waiting and self._waiting[0].read_s < oldest_s:
                    self._drop()
                if self._waiting:
                    return self._waiting.popleft()
                if self._stopped:
                    return None

    def _drop(self) -> None:
        self._waiting.popleft()
        if self._asked > 1 or not self._prepares:
            self._dropped += 1
            if self._dropped == 1:
                log.warning("%s: frames come faster than they are processed: dropping the oldest", self.name)

"""The newest frames of a live source: what cannot be processed in time is dropped."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Iterator

from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.wrapped import WrappedSource

log = logging.getLogger(__name__)

MAX_LATENCY_S = 0.2
_WAITING = 2  # frames; one more would only be older


class FreshFrames(WrappedSource):
    """A live source that never makes its device wait: a thread reads, and the oldest of the waiting frames are dropped.

    Frames keep their index, so that gaps show. It is a `Source`; one thread at a time may iterate.

    Args:
        source: the live source; closing this closes it.
        max_latency_s: a frame that has waited longer, in seconds, is dropped.
        hold: ask the source for no second frame before `restart` is called; for a recording, which waits as no camera
            does, and would be half over when everything is ready.

    Attributes:
        dropped: number of frames so far that were dropped.
        arrived_s: `time.perf_counter()` when the latest frame that iteration gave had been read.
    """

    live = False  # here a frame waits to be taken

    def __init__(self, source: Source, max_latency_s: float = MAX_LATENCY_S, *, hold: bool = False) -> None:
        self.dropped = 0
        self.arrived_s = 0.0
        super().__init__(source)
        self._max_latency_s = max_latency_s
        self._waiting: deque[tuple[float, Frame]] = deque()
        self._changed = threading.Condition()
        self._held = hold
        self._stopped = False
        self._warned = False
        self._error: BaseException | None = None
        self._reader = threading.Thread(target=self._read, name="live source")

    def __iter__(self) -> Iterator[Frame]:
        self._reader.start()
        while (frame := self._take()) is not None:
            yield frame
        if self._error is not None:
            raise self._error

    def restart(self) -> None:
        """Count dropped frames anew, and hold the source no longer: all before was preparation."""
        with self._changed:
            self.dropped = 0
            self._held = False
            self._changed.notify_all()

    def stop(self) -> None:
        """End reading as soon as the frame at hand is read, and the iteration with the frames that are waiting."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        super().stop()

    def close(self) -> None:
        """Stop, and close the source."""
        self.stop()
        if self._reader.ident is not None:
            self._reader.join()
        self._source.close()

    def _read(self) -> None:
        try:
            for frame in self._source:
                with self._changed:
                    # a program that ends without closing waits for its threads
                    if self._stopped or not threading.main_thread().is_alive():
                        return
                    if len(self._waiting) == _WAITING:
                        self._drop()
                    self._waiting.append((time.perf_counter(), frame))
                    self._changed.notify_all()
                    self._changed.wait_for(lambda: self._stopped or not self._held)
        except BaseException as error:
            self._error = error  # raised behind the frames that still wait
        finally:
            with self._changed:
                self._stopped = True
                self._changed.notify_all()

    def _take(self) -> Frame | None:
        """The oldest frame that is not too old; None when there will be no more."""
        with self._changed:
            while True:
                self._changed.wait_for(lambda: self._waiting or self._stopped)
                oldest_s = time.perf_counter() - self._max_latency_s
                while self._waiting and self._waiting[0][0] < oldest_s:
                    self._drop()
                if self.dropped and not self._warned:
                    log.warning("%s: frames come faster than they are processed: dropping the oldest", self.name)
                    self._warned = True
                if self._waiting:
                    self.arrived_s, frame = self._waiting.popleft()
                    return frame
                if self._stopped:
                    return None

    def _drop(self) -> None:
        self._waiting.popleft()
        self.dropped += 1

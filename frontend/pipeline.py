"""The way through: source, detector, tracker, sinks."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from inspect import GEN_RUNNING, getgeneratorstate
from itertools import chain
from os import PathLike
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from airline.detector import AirLine
from airline.image import Gray
from airline.trace import Trace
from frontend.cores import network_threads
from frontend.frame import Frame
from frontend.protocols import FrameResult, Source, is_live, stopping
from frontend.sources.fresh import MAX_LATENCY_S, FreshFrames
from frontend.stages import pipelined
from frontend.tracker import LineTracker
from frontend.tracks import LineTracks
from frontend.warm_up import warm_up

if TYPE_CHECKING:
    from frontend.cli.settings import RunConfig


def open_frontend(config: RunConfig) -> LineFrontend:
    """Detector and tracker of a run's settings, which leave the input's aside."""
    detector = AirLine(config=config.detector, runtime=config.runtime, threads=network_threads())
    return LineFrontend(detector, LineTracker(config.tracker))


class LineFrontend:
    """Detects and tracks lines in a stream, in constant memory.

    Example:
        >>> from frontend import LineFrontend
        >>> for tracks in LineFrontend().stream("video.mp4"):  # doctest: +SKIP
        ...     backend.add_lines(tracks.stamp_ns, tracks.ids, tracks.segments_px)
    """

    def __init__(self, detector: AirLine | None = None, tracker: LineTracker | None = None) -> None:
        """Use the given detector and tracker, or the default ones."""
        self.detector = detector or AirLine(threads=network_threads())
        self.tracker = tracker or LineTracker()

    def warm_up(self, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        """Compile and load everything by a throw-away pass, so that the first frame takes no longer than the others.

        Args:
            image: an image like those to come; the tracker forgets nothing and learns nothing from it.
        """
        warm_up(self.detector, self.tracker.config, image)

    def process(self, frame: Frame) -> FrameResult:
        """Detect and track in the next frame of a stream."""
        return self._track(self._trace(self._detect(_Read(frame, time.perf_counter()))))

    def stream(
        self, source: Source | str | PathLike[str], *, max_latency_s: float = MAX_LATENCY_S
    ) -> Iterator[LineTracks]:
        """Tracks of every frame of a source.

        Args:
            source: a `Source`, or whatever `frontend.open_source` takes: a video file, an image folder or glob, a
                camera index, a stream URL. It is read in another thread.
            max_latency_s: of a live source only, see `FreshFrames`: frames that come too fast are dropped.

        Raises:
            InputError: the source cannot be used.
        """
        from frontend.sources import open_source

        opened = open_source(source) if isinstance(source, (str, PathLike)) else source
        if is_live(opened):
            opened = FreshFrames(opened, max_latency_s)
        with closing(opened), closing(self.results(opened)) as results, stopping(opened):
            for result in results:
                yield result.tracks

    def results(
        self, source: Source, *, serial: bool = False, prepare: Callable[[Frame], None] | None = None
    ) -> Generator[FrameResult, None, None]:
        """All that is known of every frame of a source, in order.

        Reading, edge detection, the stages after it and tracking run in a thread each, so that their work on different
        frames overlaps; see `frontend.stages.pipelined` for errors and for the end. Close the generator to stop early.

        Args:
            source: the frames; left open. Of `FreshFrames`, each is taken only when the edge detector is ready for it.
            serial: do one thing after the other, in the caller's thread. The results are the same.
            prepare: called with the first frame before anything is done with it.
        """
        read = _read(source)
        try:
            first = next(read, None)
            if first is None:
                return
            if prepare is not None:
                prepare(first.frame)
                if isinstance(source, FreshFrames):
                    source.restart()
            items = chain([first], read)
            if serial:
                yield from (self._track(self._trace(self._detect(item))) for item in items)
            else:
                read_ahead = not isinstance(source, FreshFrames)
                yield from pipelined(items, self._detect, self._trace, self._track, read_ahead=read_ahead)
        finally:
            if getgeneratorstate(read) != GEN_RUNNING:  # in its thread, which a second Ctrl-C leaves behind
                read.close()

    def _detect(self, read: _Read) -> _Detected:
        gray = read.frame.gray
        started = time.perf_counter()
        edges = self.detector.edges.detect(gray)
        return _Detected(read, gray, edges, 1e3 * (time.perf_counter() - started))

    def _trace(self, detected: _Detected) -> _Traced:
        return _Traced(detected.read, self.detector.trace_edges(detected.edges, detected.gray, detected.edges_ms))

    def _track(self, traced: _Traced) -> FrameResult:
        (frame, arrived_s), trace = traced
        started = time.perf_counter()
        tracks = self.tracker.update(frame, trace.lines)
        done = time.perf_counter()
        spent = {**trace.stage_ms, "track": 1e3 * (done - started)}
        latency_s = done - arrived_s
        return FrameResult(frame, trace, tracks, spent, 1e3 * latency_s, time.time_ns() - round(1e9 * latency_s))


class _Read(NamedTuple):
    frame: Frame
    arrived_s: float  # by time.perf_counter()


class _Detected(NamedTuple):
    read: _Read
    gray: Gray
    edges: NDArray[np.float32]
    edges_ms: float


class _Traced(NamedTuple):
    read: _Read
    trace: Trace


def _read(source: Source) -> Generator[_Read, None, None]:
    for frame in source:
        yield _Read(frame, source.arrived_s if isinstance(source, FreshFrames) else time.perf_counter())

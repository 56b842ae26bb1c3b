"""The way of a frame: a source reads it, the detector finds its lines, the tracker names them, the sinks write them.

    source ──> detect_edges ──> trace_edges ──> tracker.update ──> sinks
     Frame      edges, Gray        Trace           LineTracks      FrameResult

The right image of a stereo pair goes the same way, and the tracker finds the partners of its tracks in it.
`run_pipeline` goes that way for the command lines, `LineFrontend.stream` for programs that use the library. All four
steps run at once, each on another frame.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, closing
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airline.detector import AirLine
from airline.errors import ConfigError, InputError
from airline.image import Gray
from airline.kernels.threads import cores
from airline.trace import Trace
from frontend.cli.signals import uninterrupted
from frontend.frame import Frame
from frontend.pipelined import pipelined
from frontend.protocols import FrameResult, Sink, Source
from frontend.sources import open_source
from frontend.sources.pace import MAX_LATENCY_S, FreshFrames
from frontend.sources.wrapped import Peeked
from frontend.tracker import LineTracker
from frontend.tracks import LineTracks
from frontend.warm_up import warm_up

if TYPE_CHECKING:
    from frontend.cli.settings import RunConfig
    from frontend.cli.summary import SummaryCounter

log = logging.getLogger(__name__)

Edges = tuple[NDArray[np.float32], Gray, float]  # of `AirLine.detect_edges`


def run_pipeline(
    source: Source,
    frontend: LineFrontend,
    sinks: Iterable[Sink] | Callable[[Frame], Iterable[Sink]],
    counter: SummaryCounter,
    *,
    serial: bool = False,
    advance: Callable[[FrameResult], None] = lambda result: None,
) -> None:
    """Take every frame of a source through detector and tracker into all sinks.

    Args:
        source: the frames; closed whatever happens.
        frontend: detector and tracker.
        sinks: where results go; closed whatever happens. They may come from a generator that opens them, or from a
            function of the first frame: it is asked when that has been read, so that a bad input leaves earlier output
            files alone.
        counter: counts the frames, from when the sinks are open.
        serial: see `LineFrontend.results`.
        advance: called after each frame.

    Raises:
        InputError: the source yields no frame.
        AirLineError: the source or a sink cannot be used, or not any longer.
    """
    with closing(source), ExitStack() as finishing:
        frames = Peeked(source)
        if frames.first is None:
            raise InputError(f"{source.name} yields no frame: check the input and --start, --end, --stride")
        frontend.warm_up(frames.first.image, stereo=frames.first.right is not None)

        opened: list[Sink] = []
        opening = sinks(frames.first) if callable(sinks) else sinks
        for sink in opening:  # one by one: those that are open are closed when the next one fails
            finishing.callback(_finish, sink)
            opened.append(sink)
        counter.start()

        with closing(frontend.results(frames, serial=serial)) as results:
            for result in results:
                with uninterrupted():  # a frame is in all of them, or in none
                    started = time.perf_counter()
                    for sink in opened:
                        sink.write(result)
                    counter.add(result, sinks_ms=1e3 * (time.perf_counter() - started))
                advance(result)


def _finish(sink: Sink) -> None:
    with uninterrupted():
        sink.close()


class LineFrontend:
    """Detects and tracks lines in a stream, in constant memory.

    Example:
        >>> from frontend import LineFrontend
        >>> for tracks in LineFrontend().stream("video.mp4"):  # doctest: +SKIP
        ...     for seen in (*tracks.history, tracks.take(tracks.confirmed)):
        ...         backend.add_lines(seen.stamp_ns, seen.ids, seen.observed_px, seen.observed_covariances)
    """

    def __init__(self, detector: AirLine | None = None, tracker: LineTracker | None = None) -> None:
        """Use the given detector and tracker, or the default ones."""
        self.detector = detector or AirLine(threads=network_threads())
        self.tracker = tracker or LineTracker()

    def warm_up(self, image: NDArray[np.uint8] | NDArray[np.uint16], *, stereo: bool = False) -> None:
        """Compile and load everything by a throw-away pass, so that the first frame takes no longer than the others.

        Args:
            image: an image like those to come; the tracker forgets nothing and learns nothing from it.
            stereo: pairs are to come.
        """
        warm_up(self.detector, self.tracker.config, image, stereo=stereo)

    def stream(
        self, source: Source | str | PathLike[str], *, max_latency_s: float = MAX_LATENCY_S
    ) -> Iterator[LineTracks]:
        """Tracks of every frame of a source.

        Args:
            source: a `Source`, or whatever `frontend.open_source` takes: a video file, an image folder or glob, a
                camera index, a stream URL. It is read in another thread, and closed at the end. What was guessed
                about an input that was named is logged as a warning; of a `Source` see its `notes`.
            max_latency_s: of a live source only, see `FreshFrames`: frames that come too fast are dropped.

        Raises:
            InputError: the source cannot be used.
        """
        opened = open_source(source) if isinstance(source, (str, PathLike)) else _checked(source)
        ours = opened is not source
        if opened.live:
            opened = FreshFrames(opened, max_latency_s)
        said = 0
        with closing(opened), closing(self.results(opened)) as results:
            for result in results:
                for note in opened.notes[said:] if ours else ():
                    log.warning("%s: %s", opened.name, note)
                said = len(opened.notes)
                yield result.tracks

    def results(self, source: Source, *, serial: bool = False) -> Generator[FrameResult, None, None]:
        """All that is known of every frame of a source, in order.

        Reading, edge detection, the stages after it and tracking run in a thread each, so that their work on different
        frames overlaps; see `pipelined` for errors and for the end. Close the generator to stop early.

        Args:
            source: the frames; stopped at the end, and left open. Of a live one, a frame is taken only when the edge
                detector is ready for it.
            serial: do one thing after the other, in the caller's thread. The results are the same.
        """
        if serial:
            return (self.process(frame) for frame in _checked(source))
        stages = self._detect, self._trace, self._track
        return pipelined(iter(_checked(source)), *stages, read_ahead=not source.live, stop=source.stop)

    def process(self, frame: Frame) -> FrameResult:
        """Detect and track in the next frame of a stream."""
        return self._track(self._trace(self._detect(frame)))

    def _detect(self, frame: Frame) -> tuple[Frame, list[Edges]]:
        return frame, [
            self.detector.detect_edges(image) for image in (frame.gray, frame.right_gray) if image is not None
        ]

    def _trace(self, detected: tuple[Frame, list[Edges]]) -> tuple[Frame, Trace, Trace | None]:
        frame, (left, *right) = detected
        trace = self.detector.trace_edges(*left)
        return frame, trace, self.detector.trace_edges(*right[0]) if right else None

    def _track(self, traced: tuple[Frame, Trace, Trace | None]) -> FrameResult:
        frame, trace, right = traced
        started = time.perf_counter()
        tracks = self.tracker.update(frame, trace.lines, trace.edges, right)
        done = time.perf_counter()
        spent = {**trace.stage_ms, "track": 1e3 * (done - started)}
        latency_s = done - frame.read_s
        read_ns = time.time_ns() - round(1e9 * latency_s)
        return FrameResult(frame, trace, tracks, spent, 1e3 * latency_s, read_ns, right)


def _checked(source: Source) -> Source:
    if not isinstance(source, Source):
        raise ConfigError(f"{type(source).__name__} is no source of frames: derive it from frontend.Source")
    return source


def open_frontend(config: RunConfig) -> LineFrontend:
    """Detector and tracker of a run's settings, which leave the input's aside."""
    detector = AirLine(config=config.detector, runtime=config.runtime, threads=network_threads())
    return LineFrontend(detector, LineTracker(config.tracker))


def network_threads() -> int:
    """Cores for the edge network when the other stages work beside it: half of all."""
    return max(1, cores() // 2)

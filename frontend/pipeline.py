"""The way through: source, detector, tracker, sinks."""

from __future__ import annotations

import time
from collections.abc import Iterator
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from airline.detector import AirLine
from frontend.frame import Frame
from frontend.protocols import FrameResult, Source
from frontend.tracker import LineTracker
from frontend.tracks import LineTracks


class LineFrontend:
    """Detects and tracks lines in a stream, one frame at a time, in constant memory.

    Example:
        >>> from frontend import LineFrontend
        >>> for tracks in LineFrontend().stream("video.mp4"):  # doctest: +SKIP
        ...     backend.add_lines(tracks.stamp_ns, tracks.ids, tracks.segments_px)
    """

    def __init__(self, detector: AirLine | None = None, tracker: LineTracker | None = None) -> None:
        """Use the given detector and tracker, or the default ones."""
        self.detector = detector or AirLine()
        self.tracker = tracker or LineTracker()

    def warm_up(self, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        """Compile and load everything by a throw-away pass, so that the first frame takes no longer than the others.

        Args:
            image: an image like those to come; the tracker forgets nothing and learns nothing from it.
        """
        lines = self.detector(image)
        tracker = LineTracker(self.tracker.config)
        for index in range(2):
            tracker.update(Frame(index, index, image), lines)

    def process(self, frame: Frame) -> FrameResult:
        """Detect and track in the next frame of a stream."""
        trace = self.detector.trace(frame.image)
        started = time.perf_counter()
        tracks = self.tracker.update(frame, trace.lines)
        spent = {**trace.stage_ms, "track": 1e3 * (time.perf_counter() - started)}
        return FrameResult(frame, trace, tracks, spent)

    def stream(self, source: Source | str | PathLike[str]) -> Iterator[LineTracks]:
        """Tracks of every frame of a source.

        Args:
            source: a `Source`, or whatever `frontend.open_source` takes: a video file, an image folder or glob, a
                camera index, a stream URL.

        Raises:
            InputError: the source cannot be used.
        """
        from frontend.sources import open_source

        opened = open_source(source) if isinstance(source, (str, PathLike)) else source
        try:
            for frame in opened:
                yield self.process(frame).tracks
        finally:
            opened.close()

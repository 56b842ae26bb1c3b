"""Figures of each frame, for plots."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
import rerun as rr

from frontend.protocols import FrameResult
from viz.colours import QUIET

COLOURS = {"lines": QUIET, "tracks": (150, 150, 255), "confirmed": (80, 220, 100), "lost": (150, 150, 150)}


def log_series(stream: rr.RecordingStream) -> None:
    """Log, once, the colours of the counts' curves: those of the segments, and grey for lost lines."""
    for name, colour in COLOURS.items():
        stream.log(f"/stats/counts/{name}", rr.SeriesLines(colors=colour, names=name), static=True)


def figures(result: FrameResult) -> dict[str, float]:
    """Counts of lines, the median age of confirmed tracks (frames), and ms per stage, by the name of their plot."""
    tracks = result.tracks
    ages = tracks.ages[tracks.confirmed]
    return {
        "counts/lines": len(result.trace.lines),
        "counts/tracks": len(tracks),
        "counts/confirmed": len(ages),
        "counts/lost": len(tracks.lost_ids),
        "track_length": float(np.median(ages)) if len(ages) else 0.0,
        **{f"time_ms/{stage}": ms for stage, ms in result.stage_ms.items()},
    }


class FigureLog:
    """Logs the figures under `/stats`, those of some frames at once: one by one they cost as much as a picture.

    Args:
        stream: where to log to.
        wait_s: how long a figure may wait for others.
    """

    def __init__(self, stream: rr.RecordingStream, wait_s: float) -> None:
        self._stream = stream
        self._wait_s = wait_s
        self._sent = time.monotonic()
        self._waiting: dict[str, list[tuple[int, int, float]]] = {}  # frame, stamp, value
        self._epoch = False

    def add(self, result: FrameResult, *, epoch: bool) -> None:
        """Take one frame's figures.

        Args:
            result: what they are of.
            epoch: whether the stamps of this recording count from 1970.
        """
        frame = result.frame
        for path, value in figures(result).items():
            self._waiting.setdefault(path, []).append((frame.index, frame.stamp_ns, float(value)))
        self._epoch = epoch
        if time.monotonic() - self._sent >= self._wait_s:
            self.flush()

    def flush(self) -> None:
        """Log what is waiting."""
        for path, rows in self._waiting.items():
            frames, stamps, values = zip(*rows, strict=True)
            times = _times(frames, stamps, self._epoch)
            self._stream.send_columns(f"/stats/{path}", times, rr.Scalars.columns(scalars=values))
        self._waiting.clear()
        self._sent = time.monotonic()


def _times(frames: Sequence[int], stamps_ns: Sequence[int], epoch: bool) -> list[rr.TimeColumn]:
    stamps = np.array(stamps_ns, np.int64)
    if epoch:
        sensor_time = rr.TimeColumn("sensor_time", timestamp=stamps.view("datetime64[ns]"))
    else:
        sensor_time = rr.TimeColumn("sensor_time", duration=stamps.view("timedelta64[ns]"))
    return [rr.TimeColumn("frame", sequence=frames), sensor_time]

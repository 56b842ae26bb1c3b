"""The timelines of a recording, and the figures of each frame for its plots."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from frontend.tracks import LineTracks
from viz.lines import QUIET

YEAR_2000_NS = 946_684_800_000_000_000  # stamps from then on are dates
COUNTS = {
    "lines": QUIET,
    "tracks": (150, 150, 255),
    "confirmed": (80, 220, 100),
    "measured": (220, 120, 220),
    "lost": (150, 150, 150),
}


class Clock:
    """The timelines `frame` and `sensor_time`: a date where the first stamp counts since 1970, else a duration."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._dated: bool | None = None  # a timeline cannot change its type within a recording

    def set(self, frame: int, stamp_ns: int) -> None:
        """What this thread logs from now on belongs to that frame."""
        if self._dated is None:
            self._dated = stamp_ns >= YEAR_2000_NS
        self._stream.set_time("frame", sequence=frame)
        if self._dated:
            self._stream.set_time("sensor_time", timestamp=np.datetime64(stamp_ns, "ns"))
        else:
            self._stream.set_time("sensor_time", duration=np.timedelta64(stamp_ns, "ns"))

    def columns(self, frames: Sequence[int], stamps_ns: Sequence[int]) -> list[rr.TimeColumn]:
        """Both timelines for rows that are logged at once."""
        stamps = np.array(stamps_ns, np.int64)
        kind, unit = ("timestamp", "datetime64[ns]") if self._dated else ("duration", "timedelta64[ns]")
        return [rr.TimeColumn("frame", sequence=frames), rr.TimeColumn("sensor_time", **{kind: stamps.view(unit)})]


class FigureLog:
    """Logs figures under `/stats`, those of some frames at once: one by one they cost as much as a picture.

    Args:
        stream: where to log to.
        clock: whose timelines they are on.
        wait_s: how long a figure may wait for others.
    """

    def __init__(self, stream: rr.RecordingStream, clock: Clock, wait_s: float = 0.5) -> None:
        self._stream = stream
        self._clock = clock
        self._wait_s = wait_s
        self._sent = time.monotonic()
        self._waiting: dict[str, list[tuple[int, int, float]]] = {}  # frame, stamp, value

    def name_counts(self) -> None:
        """Log, once, the colours of the counts' curves: those of the segments, and grey for lost lines."""
        for name, colour in COUNTS.items():
            self._stream.log(f"/stats/counts/{name}", rr.SeriesLines(colors=colour, names=name), static=True)

    def add(self, frame: int, stamp_ns: int, figures: Mapping[str, float]) -> None:
        """Take one frame's figures, by the names of their plots."""
        for path, value in figures.items():
            self._waiting.setdefault(path, []).append((frame, stamp_ns, float(value)))
        if time.monotonic() - self._sent >= self._wait_s:
            self.close()

    def close(self) -> None:
        """Log what is waiting."""
        for path, rows in self._waiting.items():
            frames, stamps, values = zip(*rows, strict=True)
            times = self._clock.columns(frames, stamps)
            self._stream.send_columns(f"/stats/{path}", times, rr.Scalars.columns(scalars=values))
        self._waiting.clear()
        self._sent = time.monotonic()


def track_figures(tracks: LineTracks) -> dict[str, float]:
    """Counts of tracks and the median age of confirmed ones (frames), by the name of their plot."""
    ages = tracks.ages[tracks.confirmed]
    return {
        "counts/tracks": len(tracks),
        "counts/confirmed": len(ages),
        "counts/measured": tracks.measured.sum(),
        "counts/lost": len(tracks.lost_ids),
        "track_length": median(ages),
    }


def median(values: Sequence[float] | NDArray[np.number]) -> float:
    """Of any numbers; 0 without any."""
    return float(np.median(values)) if len(values) else 0.0

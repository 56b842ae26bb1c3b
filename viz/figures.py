"""The timelines of a recording, and the figures of each frame for its plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from frontend.tracks import LineTracks

TIMELINES = "frame", "sensor_time"
YEAR_2000_NS = 946_684_800_000_000_000  # stamps from then on are dates
COLOURS = {  # of curves, RGB, in the order of the legend, which may have no place for the last ones
    "tracks": (120, 150, 255),
    "confirmed": (80, 220, 100),
    "lines": (255, 196, 64),
    "measured": (230, 110, 220),
    "lost": (170, 170, 170),
    "share, %": (80, 220, 100),
    "age, frames": (255, 196, 64),
    "edges": (80, 220, 100),
    "track": (250, 80, 80),
    "refine": (70, 200, 235),
    "grow": (255, 150, 60),
    "fit": (255, 225, 70),
    "orientation": (230, 110, 220),
    "pixels": (170, 170, 170),
}
OTHER = (200, 200, 255)  # what is alone in its plot, and stages that somebody else added


class Clock:
    """The timelines of frames and of times: dates where the first stamp counts since 1970, else durations."""

    def __init__(self, stream: rr.RecordingStream, names: tuple[str, str] = TIMELINES) -> None:
        self._stream = stream
        self._frame, self._time = names
        self._dated: bool | None = None  # a timeline cannot change its type within a recording

    def begin(self) -> None:
        """What this thread logs belongs to the beginning: no frame has come yet."""
        self._stream.set_time(self._frame, sequence=0)

    def set(self, frame: int, stamp_ns: int) -> None:
        """What this thread logs from now on belongs to that frame."""
        if self._dated is None:
            self._dated = stamp_ns >= YEAR_2000_NS
        self._stream.set_time(self._frame, sequence=frame)
        if self._dated:
            self._stream.set_time(self._time, timestamp=np.datetime64(stamp_ns, "ns"))
        else:
            self._stream.set_time(self._time, duration=np.timedelta64(stamp_ns, "ns"))


class FigureLog:
    """Logs figures under `/stats`, all curves of a plot together: one by one they cost as much as a picture.

    Args:
        stream: where to log to.
        colours: of the curves, RGB, by their names.
    """

    def __init__(self, stream: rr.RecordingStream, colours: Mapping[str, tuple[int, int, int]] = COLOURS) -> None:
        self._stream = stream
        self._colours = colours
        self._curves: dict[str, list[str]] = {}  # names, by plot

    def write(self, figures: Mapping[str, Mapping[str, float]]) -> None:
        """Log figures, by plot and curve, at the stream's present time; the first of a plot say which curves it has."""
        for plot, values in figures.items():
            if plot not in self._curves:
                names = self._curves[plot] = [
                    *(n for n in self._colours if n in values),
                    *(n for n in values if n not in self._colours),
                ]
                colours = [self._colours.get(name, OTHER) for name in names]
                look = rr.SeriesLines(names=names, colors=colours, widths=1.5)
                self._stream.log(f"/stats/{plot}", look, static=True)
            row = [values.get(name, np.nan) for name in self._curves[plot]]
            self._stream.log(f"/stats/{plot}", rr.Scalars(row))


def track_figures(tracks: LineTracks) -> dict[str, dict[str, float]]:
    """Counts of tracks and the median age of confirmed ones (frames), by plot and curve; with a right image more.

    That is which share of the confirmed ones has a partner there, and since how many frames (median).
    """
    ages = tracks.ages[tracks.confirmed]
    counts = {
        "tracks": len(tracks),
        "confirmed": len(ages),
        "measured": tracks.measured.sum(),
        "lost": len(tracks.lost_ids),
    }
    figures = {"counts": counts, "track_length": {"median": median(ages)}}
    if len(tracks.right_hits):
        since = tracks.right_hits[tracks.confirmed]
        share = 100 * np.count_nonzero(since) / max(len(since), 1)
        figures["partners"] = {"share, %": share, "age, frames": median(since[since > 0])}
    return figures


def median(values: Sequence[float] | NDArray[np.number]) -> float:
    """Of any numbers; 0 without any."""
    return float(np.median(values)) if len(values) else 0.0

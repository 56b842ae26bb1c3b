"""Figures of each frame, for plots."""

from __future__ import annotations

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


def log_figures(stream: rr.RecordingStream, result: FrameResult) -> None:
    """Log the figures under `/stats`."""
    for path, value in figures(result).items():
        stream.log(f"/stats/{path}", rr.Scalars(float(value)))

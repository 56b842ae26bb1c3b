"""The figures of a run, against slow and obvious computations."""

from __future__ import annotations

import json
import statistics
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frontend.cli.summary import WINDOW, SummaryCounter
from frontend.protocols import Source


class Tracks:
    def __init__(self, hits: list[int]) -> None:
        self.hits = np.array(hits, np.int32)

    def __len__(self) -> int:
        return len(self.hits)


def result(hits: list[int], lines: int, stage_ms: dict[str, float]) -> Any:
    """What the counter looks at in one frame's result: as many tracks as hits, and some lines."""
    trace = SimpleNamespace(lines=range(lines))
    return SimpleNamespace(trace=trace, tracks=Tracks(hits), stage_ms=stage_ms, latency_ms=1.0)


@given(
    seen=st.lists(st.lists(st.booleans(), min_size=12, max_size=12), max_size=30),
    more_lines=st.lists(st.integers(0, 5), min_size=12, max_size=12),
    times=st.lists(st.floats(0, 1000), min_size=12, max_size=12),
    frames=st.integers(1, 12),
    confirm_hits=st.integers(1, 5),
    skipped=st.integers(0, 3),
)
def test_figures(seen, more_lines, times, frames, confirm_hits, skipped):
    """`seen` says of each track in which frames it was seen."""
    counter = SummaryCounter(confirm_hits)
    live, lines = [], []
    for k in range(frames):
        hits = [sum(track[: k + 1]) for track in seen if track[k]]
        live.append(len(hits))
        lines.append(len(hits) + more_lines[k])
        counter.add(result(hits, lines[-1], {"edges": times[k]}), sinks_ms=2 * times[k])
    source = Source()
    source.skipped = skipped
    summary = counter.summary(source)

    lengths = [sum(track[:frames]) for track in seen]
    confirmed = [length for length in lengths if length >= confirm_hits]
    assert (summary.frames, summary.skipped_frames) == (frames, skipped)
    assert summary.tracks == len(confirmed)
    assert summary.track_length_median == (statistics.median(confirmed) if confirmed else 0)
    assert summary.lines_per_frame == pytest.approx(statistics.mean(lines), abs=0.00501)
    assert summary.live_tracks_per_frame == pytest.approx(statistics.mean(live), abs=0.00501)
    median = statistics.median(times[:frames])
    assert summary.stage_ms == pytest.approx({"edges": median, "sinks": 2 * median}, abs=0.0005)
    assert json.loads(json.dumps(summary.to_dict())) == summary.to_dict()


def test_a_run_without_frames() -> None:
    summary = SummaryCounter(3).summary(Source())
    assert (summary.frames, summary.fps, summary.tracks, summary.skipped_frames) == (0, 0, 0, 0)
    assert summary.stage_ms == {}
    assert summary.table().row_count > 0


def test_memory_does_not_grow_with_the_run() -> None:
    """Medians are over the latest frames, and there they are exact."""
    counter = SummaryCounter(3)
    rng = np.random.default_rng(0)
    times = [1000.0] * WINDOW + rng.uniform(0, 50, WINDOW).tolist()
    one = result([], 0, {})
    for spent in times:
        counter.add(one, spent)
    assert counter.summary(Source()).stage_ms["sinks"] == pytest.approx(statistics.median(times[-WINDOW:]), abs=0.0005)

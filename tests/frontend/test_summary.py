"""The figures of a run, against slow and obvious computations."""

from __future__ import annotations

import json
import statistics
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frontend.cli.summary import WINDOW, SummaryCounter
from frontend.protocols import Source
from frontend.tracks import LineTracks
from tests.helpers.made_tracks import blank_tracks

ERRORS = np.diag([0.01, 0.0001]).astype(np.float32)  # of a partner, beyond those of its line


def result(tracks: LineTracks, lines: int, stage_ms: dict[str, float]) -> Any:
    """What the counter looks at in one frame's result: the tracks, and some lines."""
    return SimpleNamespace(trace=SimpleNamespace(lines=range(lines)), tracks=tracks, stage_ms=stage_ms, latency_ms=1.0)


@given(
    # of each track and frame: not seen, seen and left out, or handed out: as detected, measured, stable, or both
    seen=st.lists(st.lists(st.sampled_from(["", "left", "-", "m", "s", "ms"]), min_size=12, max_size=12), max_size=30),
    more_lines=st.lists(st.integers(0, 5), min_size=12, max_size=12),
    times=st.lists(st.floats(0, 1000), min_size=12, max_size=12),
    frames=st.integers(1, 12),
    confirm_hits=st.integers(1, 5),
    skipped=st.integers(0, 3),
)
def test_figures(seen, more_lines, times, frames, confirm_hits, skipped):
    counter = SummaryCounter(confirm_hits)
    live, lines, left_out = [], [], []
    for k in range(frames):
        out = [i for i, track in enumerate(seen) if track[k] in ("-", "m", "s", "ms")]
        hits = np.array([sum(map(bool, seen[i][: k + 1])) for i in out], np.int32)
        measured, stable = (np.array([kind in seen[i][k] for i in out], np.bool_) for kind in "ms")
        ended = np.array([i for i, track in enumerate(seen) if k and not any(track[k:]) and track[k - 1]], np.int64)
        tracks = blank_tracks(len(out), ids=np.array(out, np.int64), hits=hits, measured=measured, stable=stable)
        left_out.append(sum(track[k] == "left" for track in seen))
        live.append(tracks)
        lines.append(len(hits) + more_lines[k])
        ending = replace(tracks, ended_ids=ended, left_out=left_out[-1])
        counter.add(result(ending, lines[-1], {"edges": times[k]}), sinks_ms=2 * times[k])
    source = Source()
    source.skipped = skipped
    summary = counter.summary(source)

    lengths = {i: hits for tracks in live for i, hits in zip(tracks.ids.tolist(), tracks.hits.tolist(), strict=True)}
    confirmed = [length for length in lengths.values() if length >= confirm_hits]
    assert (summary.frames, summary.skipped_frames) == (frames, skipped)
    assert (summary.tracks, summary.ids) == (len(confirmed), len(lengths))
    assert summary.track_length_median == (statistics.median(confirmed) if confirmed else 0)
    assert summary.lines_per_frame == pytest.approx(statistics.mean(lines), abs=0.00501)
    observations, measured = sum(map(len, live)), sum(tracks.measured.sum() for tracks in live)
    assert summary.live_tracks_per_frame == pytest.approx(observations / frames, abs=0.00501)
    assert summary.stable_tracks_per_frame == pytest.approx(sum(t.stable.sum() for t in live) / frames, abs=0.00501)
    assert summary.measured_per_frame == pytest.approx(measured / frames, abs=0.00501)
    assert summary.measured_share == pytest.approx(measured / max(observations, 1), abs=0.0000501)
    assert summary.left_out_per_frame == pytest.approx(statistics.mean(left_out), abs=0.00501)
    median = statistics.median(times[:frames])
    assert summary.stage_ms == pytest.approx({"edges": median, "sinks": 2 * median}, abs=0.000501)
    assert json.loads(json.dumps(summary.to_dict())) == summary.to_dict()


def test_resets_are_counted_and_the_first_is_named() -> None:
    counter = SummaryCounter(3)
    for reason in (None, "a gap", None, "a cut"):
        counter.add(result(replace(blank_tracks(0), reset=reason), 0, {}), 0.0)
    summary = counter.summary(Source())
    assert (summary.resets, summary.first_reset) == (2, "a gap")


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
    one = result(blank_tracks(0), 0, {})
    for spent in times:
        counter.add(one, spent)
    assert counter.summary(Source()).stage_ms["sinks"] == pytest.approx(statistics.median(times[-WINDOW:]), abs=0.0005)


def test_partners_are_counted_where_there_is_a_right_image() -> None:
    """Of four tracks, the last two are confirmed; only the upright one of the last frame has a depth."""
    counter = SummaryCounter(3)
    segments = np.tile(np.float32([[9, 5], [50, 5]]), (4, 1, 1))
    segments[3] = [[60, 10], [60, 50]]
    tracks = blank_tracks(4, observed_px=segments, states=np.uint8([0, 0, 1, 1]))
    right = {"right_covariances": np.tile(ERRORS, (4, 1, 1)), "right_measured": np.zeros(4, np.bool_)}
    for hits in ([0, 0, 0, 0], [2, 1, 1, 2]):
        partners = np.where(np.array(hits)[:, None, None] > 0, segments - np.float32([7, 0]), np.float32(np.nan))
        found = replace(tracks, right_px=partners, right_hits=np.array(hits, np.int32), **right)
        counter.add(result(found, 4, {}), 0.0)
    counter.add(result(replace(blank_tracks(0)), 0, {}), 0.0)
    summary = counter.summary(Source())
    assert (summary.partners_per_frame, summary.partner_share, summary.depth_known_share) == (0.67, 0.5, 0.25)
    cells = dict(zip(*(column.cells for column in summary.table().columns[1:]), strict=True))
    assert cells["confirmed, with a partner"] == "0.7 (50.0%; 25.0% tell a depth)"
    mono = SummaryCounter(3).summary(Source())
    assert (mono.partners_per_frame, mono.to_dict()["partner_share"], mono.depth_known_share) == (None, None, None)
    assert "confirmed, with a partner" not in mono.table().columns[1].cells


@pytest.mark.parametrize(
    ("shift", "with_partner", "words"),
    [
        ((7, 0.2), 50, None),
        ((7, 0), 10, "10% of the lines have a partner, so the images may be no"),
        ((0, 0), 50, "nearly the same"),
        ((7, -1), 50, "rows are -1.0 px off"),
    ],
)
def test_what_is_hardly_a_pair_is_said(shift: tuple[float, float], with_partner: int, words: str | None) -> None:
    counter, count = SummaryCounter(3), 100
    segments = np.tile(np.float32([[60, 10], [60, 50]]), (count, 1, 1))
    hits = (np.arange(count) < with_partner).astype(np.int32)
    partners = np.where(hits[:, None, None] > 0, segments - np.float32(shift) * (1, -1), np.nan).astype(np.float32)
    right = {"right_covariances": np.tile(ERRORS, (count, 1, 1)), "right_measured": np.zeros(count, np.bool_)}
    tracks = blank_tracks(count, observed_px=segments, states=np.ones(count, np.uint8))
    for _ in range(2):
        counter.add(result(replace(tracks, right_px=partners, right_hits=hits, **right), count, {}), 0.0)
    notes = counter.summary(Source()).notes
    assert notes == [] if words is None else words in notes[0]


def test_points_are_counted_and_said_where_there_are_any() -> None:
    counter = SummaryCounter(3)
    for count in (3, 0, 4):
        counter.add(result(replace(blank_tracks(0), point_ids=np.arange(count)), 0, {}), 0.0)
    summary = counter.summary(Source())
    assert summary.points_per_frame == 2.33
    assert "points per frame" in summary.table().columns[1].cells
    assert "points per frame" not in SummaryCounter(3).summary(Source()).table().columns[1].cells

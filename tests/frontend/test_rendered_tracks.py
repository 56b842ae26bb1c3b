"""The tracker behind the detector on rendered clips, whose lines and poses are known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from airline import AirLine
from airline.scenes import RenderedClip
from frontend import Frame, LineTracker
from frontend.evaluation.accuracy import accuracy
from frontend.evaluation.consistency import consistency
from frontend.evaluation.metrics import identity_scores
from frontend.evaluation.observations import collect
from frontend.evaluation.rendered import DARK, LIGHT, SceneClip
from frontend.evaluation.truth import Record, owners
from tests.helpers.tracking_frames import line_set

SMALL, LARGE = (320, 240), (640, 480)
CLIPS = {
    "room": ("indoor", "handheld", 3, 30, SMALL, LIGHT),
    "street": ("street", "slow", 4, 16, SMALL, LIGHT),
    "bare": ("indoor", "handheld", 8, 12, SMALL, LIGHT),
    "dark": ("indoor", "handheld", 12, 15, LARGE, DARK),
}


@cache
def clip(name: str) -> SceneClip:
    kind, motion, seed, frames, size, effects = CLIPS[name]
    view = {"size": size, "effects": effects, "min_contrast": 1.0, "merge_doubles": False}
    return SceneClip(name, (RenderedClip(kind, motion, seed, frames, **view),))


@cache
def run(name: str) -> list[Record]:
    detector, tracker, records = AirLine(), LineTracker(), []
    for frame, truth in clip(name):
        trace = detector.trace_edges(*detector.detect_edges(frame.gray))
        tracks = tracker.update(frame, trace.lines, trace.edges)
        records.append(Record(tracks, owners(trace.lines.segments, truth), truth, CLIPS[name][4], 0.0))
    return records


def test_true_lines_keep_their_identity():
    tracker, owner, right, wrong = LineTracker(), {}, 0, 0
    for index, view in enumerate(RenderedClip(kind="indoor", motion="handheld", seed=3, frames=20)):
        long = np.linalg.norm(view.segments_px[:, 1] - view.segments_px[:, 0], axis=1) > 20
        tracks = tracker.update(Frame(index, view.stamp_ns, view.image), line_set(view.segments_px[long]))
        for track, line in zip(tracks.ids.tolist(), view.ids[long][tracks.line_indices].tolist(), strict=True):
            if track in owner:
                right, wrong = right + (owner[track] == line), wrong + (owner[track] != line)
            owner[track] = line
    assert right > 1000
    assert right / (right + wrong) > 0.98


@pytest.mark.parametrize("name", ["room", "street"])
def test_tracks_are_lines_in_space(name):
    observations = collect([record.tracked for record in run(name)])
    observed, fused = (
        consistency(observations, segments, clip(name), len(clip(name)))
        for segments in (observations.observed_px, observations.segments_px)
    )
    assert fused["tracks"] > 200
    assert fused["share"] > 0.97
    assert fused["share"] > observed["share"], "a fused line is no worse than what was seen of it"
    assert fused["rms_across_px"] < 0.75 * observed["rms_across_px"]


def test_tracks_stay_with_their_lines():
    scores = {name: identity_scores(run(name)) for name in ("room", "street", "dark")}
    assert all(score["link_precision"] > 0.995 for score in scores.values())
    assert scores["dark"]["link_recall"] > 0.94


@pytest.mark.parametrize("kind", ["observed", "fused"])
def test_covariances_are_honest(kind):
    """Of normal errors 68 % are within one standard deviation."""
    figures = accuracy(run("room"))[kind]
    assert figures["lines"] > 2000
    assert 0.7 < figures["offset_68"] < 1.35
    assert 0.7 < figures["angle_68"] < 1.35


@pytest.mark.parametrize("name", ["room", "dark"])
def test_what_a_frame_promises(name):
    born: dict[int, int] = {}
    for index, record in enumerate(run(name)):
        tracks = record.tracked
        assert (tracks.confirmed == (tracks.hits >= 3)).all()
        assert (tracks.hits <= tracks.ages + 1).all()
        assert (tracks.line_indices[tracks.measured] == -1).all()
        found = tracks.line_indices[~tracks.measured]
        assert len(np.unique(found)) == len(found), "no line has two tracks"
        assert len(found) >= 0.98 * len(record.line_owners), "each has one, unless it lies on another"
        for track, age in zip(tracks.ids.tolist(), tracks.ages.tolist(), strict=True):
            assert born.setdefault(track, index) == index - age
        assert not set(tracks.ids.tolist()) & set(tracks.lost_ids.tolist())
    assert record.tracked.measured.any()


def test_the_table_does_not_grow():
    detector, sizes = AirLine("fast"), []
    frames = [frame for frame, _ in clip("bare")]
    traces = [detector.trace_edges(*detector.detect_edges(frame.gray)) for frame in frames]
    there_and_back = [*range(12), *range(10, 0, -1)]
    tracker = LineTracker()
    for index in range(300):
        k = there_and_back[index % len(there_and_back)]
        stamp = index * 33_000_000
        tracks = tracker.update(Frame(index, stamp, frames[k].image), traces[k].lines, traces[k].edges)
        assert tracks.reset is None
        assert tracker._tracks is not None
        sizes.append(len(tracker._tracks))
    assert np.mean(sizes[200:]) < 1.1 * np.mean(sizes[30:130])
    assert max(sizes[100:]) < 2.5 * max(len(trace.lines) for trace in traces)

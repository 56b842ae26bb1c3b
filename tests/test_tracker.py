"""The tracker on rendered lines of known identity, and its promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airline import ConfigError, LineSet
from airline.scenes import Sequence
from frontend import Frame, LineTracker, TrackerConfig, TrackState
from frontend.motion import predict_segments
from frontend.overlap import assign, overlap_votes


def line_set(segments: np.ndarray) -> LineSet:
    """Lines with descriptors made of their angles, as six line kernels would answer."""
    segments = np.asarray(segments, np.float32).reshape(-1, 2, 2)
    delta = segments[:, 1] - segments[:, 0]
    angles = np.arctan2(delta[:, 1], delta[:, 0])[:, None] - np.arange(6) * np.pi / 6
    descriptors = np.cos(2 * angles).astype(np.float32)
    return LineSet(
        segments, np.ones(len(segments), np.float32), descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)
    )


def texture(seed: int = 0, size: tuple[int, int] = (200, 160)) -> np.ndarray:
    import cv2

    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.normal(0, 60, (size[1] + 100, size[0] + 100)), (0, 0), 2)
    return np.clip(128 + 4 * noise, 0, 255).astype(np.uint8)


def frame(index: int, shift: int = 0, stamp_ns: int | None = None, size: tuple[int, int] = (200, 160)) -> Frame:
    image = np.ascontiguousarray(texture(size=size)[50 : 50 + size[1], 50 - shift : 50 - shift + size[0]])
    return Frame(index, index * 33_000_000 if stamp_ns is None else stamp_ns, image)


LINES = np.array([[[20, 20], [120, 30]], [[30, 60], [30, 140]], [[60, 120], [150, 60]]], np.float32)


def test_rendered_lines_keep_their_identity():
    tracker, owner, right, wrong = LineTracker(), {}, 0, 0
    for index, view in enumerate(Sequence(kind="indoor", motion="handheld", seed=3, frames=40)):
        long = np.linalg.norm(view.segments_px[:, 1] - view.segments_px[:, 0], axis=1) > 20
        tracks = tracker.update(Frame(index, view.stamp_ns, view.image), line_set(view.segments_px[long]))
        for track, line in zip(tracks.ids.tolist(), view.ids[long][tracks.line_indices].tolist(), strict=True):
            if track in owner:
                right, wrong = right + (owner[track] == line), wrong + (owner[track] != line)
            owner[track] = line
    assert right > 2000
    assert right / (right + wrong) > 0.98


def test_life_of_a_track():
    tracker = LineTracker(TrackerConfig(confirm_hits=3, max_missed=2))
    states = [tracker.update(frame(i), line_set(LINES)).states.tolist() for i in range(3)]
    assert states == [[TrackState.TENTATIVE] * 3, [TrackState.TENTATIVE] * 3, [TrackState.CONFIRMED] * 3]
    assert len(tracker.update(frame(3), line_set(LINES[:2]))) == 2
    back = tracker.update(frame(4), line_set(LINES))
    assert back.ids.tolist() == [0, 1, 2], "a short occlusion must not change the id"
    assert back.ages.tolist() == [4, 4, 4]
    assert back.hits.tolist() == [5, 5, 4]
    for i in range(5, 8):
        tracker.update(frame(i), line_set(LINES[:2]))
    late = tracker.update(frame(8), line_set(LINES))
    assert late.ids.tolist() == [0, 1, 3], "after max_missed frames the line is a new one"


def test_a_tentative_track_ends_when_missed_once():
    tracker = LineTracker()
    tracker.update(frame(0), line_set(LINES[:1]))
    tracker.update(frame(1), line_set(LINES[:0]))
    assert tracker.update(frame(2), line_set(LINES[:1])).ids.tolist() == [1]


def test_follows_a_shift_of_the_image():
    tracker = LineTracker()
    for i in range(5):
        tracks = tracker.update(frame(i, shift=9 * i), line_set(LINES + np.float32([9 * i, 0])))
    assert tracks.ids.tolist() == [0, 1, 2]


def test_end_points_keep_their_order():
    tracker = LineTracker()
    first = tracker.update(frame(0), line_set(LINES))
    second = tracker.update(frame(1), line_set(LINES[:, ::-1]))
    assert np.array_equal(first.segments_px, second.segments_px)


@pytest.mark.parametrize(
    ("second", "reason"),
    [
        (frame(1, stamp_ns=5_000_000_000), "gap of 5.000 s"),
        (frame(1, stamp_ns=-1_000_000), "time went back"),
        (frame(1, size=(160, 120)), "resolution changed from 200x160 to 160x120"),
    ],
)
def test_resets_with_a_reason(second, reason):
    tracker = LineTracker()
    assert tracker.update(frame(0), line_set(LINES)).reset is None
    tracks = tracker.update(second, line_set(LINES))
    assert reason in tracks.reset
    assert tracks.ids.tolist() == [3, 4, 5], "no track lives across a reset"
    assert tracker.update(Frame(2, second.stamp_ns + 1, second.image), line_set(LINES)).reset is None


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 8))
def test_promises_on_random_lines(seed, frames):
    rng = np.random.default_rng(seed)
    runs = []
    sets = [line_set(rng.uniform(0, 160, (rng.integers(0, 25), 2, 2))) for _ in range(frames)]
    for _ in range(2):
        tracker, seen, newest = LineTracker(), set(), -1
        result = []
        for i, lines in enumerate(sets):
            tracks = tracker.update(frame(i), lines)
            ids = tracks.ids.tolist()
            assert len(set(ids)) == len(ids)
            assert ids == sorted(ids)
            assert sorted(tracks.line_indices.tolist()) == list(range(len(lines))), "one line, one track"
            fresh = [t for t in ids if t not in seen]
            assert all(t > newest for t in fresh), "ids are never reused"
            newest = max([newest, *fresh])
            seen.update(ids)
            result.append(ids)
        runs.append(result)
    assert runs[0] == runs[1], "the same stream gives the same ids"


def test_prediction_follows_each_line():
    before, after = frame(0).image, frame(0, shift=12).image
    moved = predict_segments(before, after, LINES)
    assert np.abs(moved - LINES - np.float32([12, 0])).max() < 0.6


def test_prediction_without_texture_stays():
    flat = np.full((160, 200), 90, np.uint8)
    assert np.abs(predict_segments(flat, flat, LINES) - LINES).max() < 0.5


def test_votes_of_hand_made_pairs():
    track = line_set([[[0, 0], [100, 0]]])
    lines = line_set([[[0, 0], [100, 0]], [[50, 2], [150, 2]], [[0, 0], [0, 100]], [[0, 50], [100, 50]]])
    votes = overlap_votes(track.segments, track.descriptors, lines.segments, lines.descriptors, 4.0, 0.8)
    assert votes[0] == pytest.approx([1.0, 0.5 * 0.5, 0, 0], abs=1e-5)


def test_assignment_is_one_to_one_and_strongest_first():
    votes = np.array([[0.9, 0.8, 0], [0.95, 0, 0], [0, 0.1, 0.05]], np.float32)
    assert assign(votes, 0.2).tolist() == [1, 0, -1]
    assert assign(np.zeros((0, 3), np.float32), 0.2).tolist() == []


def test_refuses_impossible_settings():
    with pytest.raises(ConfigError, match="band"):
        TrackerConfig(band=0)

"""The tracker: the life of a track, lines that break, resets, and its promises."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airline import ConfigError
from frontend import Frame, LineTracker, TrackerConfig, TrackState
from frontend.tracking.overlap import covered
from tests.helpers.tracking_frames import drawn, frame, line_set

LINES = np.array([[[20, 20], [120, 30]], [[30, 60], [30, 140]], [[60, 120], [150, 60]]], np.float32)
NONE = LINES[:0]
MIDDLE = 40  # px, so that a plane that moves one way stays in sight


def begin(lines: np.ndarray = LINES, frames: int = 3, **settings: object) -> LineTracker:
    """A tracker that has seen the lines in some frames of a resting camera."""
    tracker = LineTracker(TrackerConfig(**settings))
    for index in range(frames):
        tracker.update(frame(index), line_set(lines))
    return tracker


def test_a_tentative_track_is_confirmed_by_its_third_frame():
    tracker = LineTracker()
    states = [tracker.update(frame(i), line_set(LINES)).states.tolist() for i in range(4)]
    assert states == [[TrackState.TENTATIVE] * 3] * 2 + [[TrackState.CONFIRMED] * 3] * 2


def test_a_tentative_track_that_is_missed_too_often_ends():
    tracker = begin(frames=1, max_missed_tentative=1)
    assert tracker.update(frame(1), line_set(LINES[:2])).ended_ids.tolist() == []
    assert tracker.update(frame(1), line_set(LINES)).ids.tolist() == [0, 1, 2], "it may be missed once"
    assert tracker.update(frame(1), line_set(LINES[:2])).ended_ids.tolist() == []
    gone = tracker.update(frame(2), line_set(LINES[:2]))
    assert gone.ended_ids.tolist() == [2]
    assert gone.lost_ids.tolist() == [], "only confirmed tracks are reported as lost"
    assert tracker.update(frame(3), line_set(LINES)).ids.tolist() == [0, 1, 3]


def test_a_confirmed_track_is_lost_moves_on_and_is_found_again():
    tracker = begin(frames=8)
    for k in range(1, 6):
        tracks = tracker.update(frame(7 + k, shift=4 * k), line_set(LINES[:2] + np.float32([4 * k, 0])))
        assert tracks.ids.tolist() == [0, 1]
        assert tracks.lost_ids.tolist() == [2]
        assert np.abs(tracks.lost_segments_px[0] - LINES[2] - np.float32([4 * k, 0])).max() < 1.0
    back = tracker.update(frame(13, shift=24), line_set(LINES + np.float32([24, 0])))
    assert back.ids.tolist() == [0, 1, 2]
    assert back.lost_ids.tolist() == []
    assert back.ages.tolist() == [13, 13, 13]
    assert back.hits.tolist() == [14, 14, 9]


def test_a_lost_track_is_removed_and_never_comes_back():
    tracker = begin(max_missed=2)
    ended = [tracker.update(frame(i), line_set(LINES[:2])).ended_ids.tolist() for i in range(3, 7)]
    assert ended == [[], [], [2], []]
    assert tracker.update(frame(7), line_set(LINES)).ids.tolist() == [0, 1, 3]


@pytest.mark.parametrize(("hits", "patience"), [(3, 3), (4, 4), (9, 6), (30, 17), (40, 18)])
def test_a_track_is_lost_for_as_long_as_half_its_life_and_two_frames_more(hits, patience):
    tracker, lost = begin(frames=hits, max_missed=18), 0
    for index in range(hits, hits + 25):
        tracks = tracker.update(frame(index), line_set(LINES[:2]))
        lost += tracks.lost_ids.tolist() == [2]
        assert (tracks.ended_ids.tolist() == [2]) == (index == hits + patience)
    assert lost == patience


def test_a_track_that_leaves_the_image_ends():
    tracker = begin(np.concatenate([LINES, [[[185, 20], [190, 100]]]]), frames=8)
    ended = []
    for k in range(1, 5):
        tracks = tracker.update(frame(7 + k, shift=5 * k), line_set(LINES[:1] + np.float32([5 * k, 0])))
        ended += tracks.ended_ids.tolist()
    assert ended == [3]


def test_tracks_wait_while_the_camera_sees_nothing():
    tracker = begin()
    for k in range(3, 6):
        blind = tracker.update(Frame(k, k * 33_000_000, np.zeros((160, 200), np.uint8)), line_set(NONE))
        assert blind.lost_ids.tolist() == [0, 1, 2]
        assert np.allclose(blind.lost_segments_px, LINES, atol=0.5)
    after = tracker.update(frame(6, shift=12), line_set(LINES + np.float32([12, 0])))
    assert after.ids.tolist() == [0, 1, 2]


def test_a_broken_line_goes_on_with_its_longest_piece_and_reports_the_other():
    whole = np.array([[[20, 20], [180, 20]], [[20, 26], [180, 26]]], np.float32)
    pieces = np.array([[[20, 20], [110, 20]], [[120, 20], [180, 20]], [[20, 26], [180, 26]]], np.float32)
    tracker = LineTracker()
    for k in range(3):
        tracker.update(drawn(k, whole), line_set(whole))
    for k in range(3, 7):
        broken = tracker.update(drawn(k, pieces), line_set(pieces))
        assert broken.ids.tolist() == [0, 1, 2]
        assert broken.line_indices.tolist() == [0, 2, 1]
        assert broken.fragment_of.tolist() == [-1, -1, 0]
        assert np.allclose(broken.observed_px[0], pieces[0])
        usual = 180 if k < 5 else 110
        assert broken.segments_px[0, 1, 0] == pytest.approx(usual, abs=1), "where it ended in most of the last frames"
    joined = tracker.update(drawn(7, whole), line_set(whole))
    assert joined.ids.tolist() == [0, 1]
    assert joined.ended_ids.tolist() == [2], "a piece that is part of the whole again is no line of its own"
    assert joined.lost_ids.tolist() == []


def test_a_parallel_line_is_no_fragment():
    tracker = begin(LINES[:1])
    both = tracker.update(frame(3), line_set(np.concatenate([LINES[:1], LINES[:1] + np.float32([0, 1.8])])))
    assert both.fragment_of.tolist() == [-1, -1]


def test_pieces_that_join_keep_the_longer_ones_id():
    pieces = np.array([[[20, 20], [110, 20]], [[120, 20], [180, 20]]], np.float32)
    whole = np.array([[[20, 20], [180, 20]]], np.float32)
    tracker = LineTracker()
    for k in range(3):
        tracker.update(drawn(k, pieces), line_set(pieces))
    joined = tracker.update(drawn(3, whole), line_set(whole))
    assert joined.ids.tolist() == [0]
    assert joined.lost_ids.tolist() == [1]
    assert joined.observed_px[0, 1, 0] == 180
    assert joined.segments_px[0, 1, 0] == pytest.approx(110, abs=1), "an extent grows when a line grew for good"
    apart = tracker.update(drawn(4, pieces), line_set(pieces))
    assert apart.ids.tolist() == [0, 1], "and both are there when it breaks again"


@pytest.mark.parametrize(("step", "frames"), [(9, (0, 1, 2)), (40, (0, 1, 2)), (30, (0, 1, 3))])
def test_follows_a_moving_image(step, frames):
    """Also over a skipped frame."""
    tracker = LineTracker()
    for i in frames:
        shift = step * i - MIDDLE
        tracks = tracker.update(frame(i, shift=shift, size=(400, 300)), line_set(LINES + np.float32([150 + shift, 60])))
    assert tracks.ids.tolist() == [0, 1, 2]


def test_end_points_keep_their_order():
    tracker, plane = LineTracker(), drawn(0, [[50, 80], [150, 80]]).image
    for k in range(70):
        turn = cv2.getRotationMatrix2D((100, 80), -6 * k, 1.0)
        image = cv2.warpAffine(plane, turn, (200, 160), borderMode=cv2.BORDER_REFLECT)
        segment = np.array([[50, 80], [150, 80]]) @ turn[:, :2].T + turn[:, 2]
        # the detector begins at whichever end is further left
        detected = segment if segment[0, 0] <= segment[1, 0] else segment[::-1]
        tracks = tracker.update(Frame(k, k, image), line_set([detected]))
        assert tracks.ids.tolist() == [0]
        assert np.abs(tracks.observed_px[0] - segment).max() < 1e-4
        assert np.abs(tracks.segments_px[0] - segment).max() < 8


def test_a_resting_line_is_steadier_than_its_detections():
    rng = np.random.default_rng(5)
    line = np.array([[[30, 30], [150, 100]]], np.float32)
    normal = np.array([-70, 120]) / np.hypot(70, 120)
    tracker, errors, raw, sigma = LineTracker(), [], [], []
    for k in range(60):
        noisy = line + rng.normal(0, 0.4, (1, 2, 2)).astype(np.float32)
        tracks = tracker.update(frame(0, stamp_ns=k), line_set(noisy))
        errors.append((tracks.segments_px[0] - line[0]).mean(axis=0) @ normal)
        raw.append((noisy[0] - line[0]).mean(axis=0) @ normal)
        sigma.append(np.sqrt(tracks.covariances[0, 0, 0]))
    assert np.std(errors[10:]) < 0.5 * np.std(raw[10:])
    assert np.max(np.abs(errors[10:])) < 3 * sigma[-1]
    assert sigma[-1] < sigma[0]


@pytest.mark.parametrize(
    ("second", "reason"),
    [
        (frame(3, stamp_ns=5_000_000_000), "gap of 4.934 s"),
        (frame(3, stamp_ns=-1_000_000), "time went back"),
        (frame(3, size=(160, 120)), "resolution changed from 200x160 to 160x120"),
    ],
)
def test_resets_with_a_reason(second, reason):
    tracker = begin()
    tracks = tracker.update(second, line_set(LINES))
    assert reason in tracks.reset
    assert tracks.ids.tolist() == [3, 4, 5], "no track lives across a reset"
    assert tracks.ended_ids.tolist() == [0, 1, 2]
    after = tracker.update(Frame(4, second.stamp_ns + 1, second.image), line_set(LINES))
    assert after.reset is None
    assert after.ids.tolist() == [3, 4, 5]


def test_a_scene_cut_ends_all_tracks():
    rng = np.random.default_rng(1)
    first, second = (line_set(rng.uniform(5, 155, (25, 2, 2))) for _ in range(2))
    tracker = LineTracker()
    for k in range(3):
        assert tracker.update(frame(k), first).reset is None
    cut = tracker.update(frame(3, seed=9), second)
    assert cut.reset is not None
    assert cut.reset.startswith("scene cut")
    assert cut.ids.min() == 25
    assert cut.ended_ids.tolist() == list(range(25))
    assert tracker.update(frame(4, seed=9), second).reset is None


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(2, 10))
def test_promises_on_random_lines(seed, frames):
    rng = np.random.default_rng(seed)
    pool = rng.uniform(0, 160, (40, 2, 2))
    sets = [line_set(pool[rng.random(40) < 0.5] + rng.normal(0, 0.5, 2)) for _ in range(frames)]
    runs = []
    for _ in range(2):
        tracker, seen, ended, newest, result = LineTracker(TrackerConfig(max_missed=2)), set(), set(), -1, []
        for i, lines in enumerate(sets):
            tracks = tracker.update(frame(i), lines)
            ids = tracks.ids.tolist()
            assert ids == sorted(set(ids)), "ids are unique and ascend"
            left = np.setdiff1d(np.arange(len(lines)), tracks.line_indices)
            assert len(tracks) + len(left) == len(lines), "one line, one track"
            assert covered(lines.segments[left], tracks.observed_px).all(), "or none where it lies on another"
            assert all(t > newest for t in ids if t not in seen), "ids are never reused"
            assert not ended & {*ids, *tracks.lost_ids.tolist()}, "what has ended stays away"
            assert not set(ids) & set(tracks.lost_ids.tolist())
            assert np.isfinite(tracks.segments_px).all()
            assert (np.linalg.eigvalsh(tracks.covariances) > 0).all()
            newest = max([newest, *ids])
            seen.update(ids)
            ended.update(tracks.ended_ids.tolist())
            result.append((ids, tracks.segments_px.tobytes(), tracks.lost_ids.tolist()))
        assert seen >= ended
        runs.append(result)
    assert runs[0] == runs[1], "the same stream gives the same tracks"


@pytest.mark.parametrize(
    "settings", [{"band": 0}, {"confirm_hits": 0}, {"max_gap_s": 0}, {"max_lines": -1}, {"gate": 0}]
)
def test_refuses_impossible_settings(settings):
    with pytest.raises(ConfigError, match=next(iter(settings))):
        TrackerConfig(**settings)

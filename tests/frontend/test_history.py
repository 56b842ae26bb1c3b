"""The history of tracks: what goes in comes out, per track, in bounded memory; and a confirmation brings it along."""

from __future__ import annotations

import weakref
from collections import defaultdict
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.errors import ConfigError, InputError
from frontend.camera.model import CameraModel
from frontend.history import Confirmations, Observations, TrackHistory
from frontend.tracks import DERIVED, FIELDS, LineTracks
from tests.helpers.made_tracks import FISHEYE, assert_same, blank_tracks, clip_results, made_tracks

CAMERA = CameraModel(640, 480, 500, 500, 320, 240, "radial-tangential", np.array([-0.28, 0.07, 2e-4, 2e-5]))


def segments_of(frame: int, ids: list[int]) -> np.ndarray:
    """Segments that tell their frame and their track."""
    return np.array([[[k % 600, frame % 400], [k % 600 + 30, frame % 400 + 5]] for k in ids], np.float32).reshape(
        -1, 2, 2
    )


def tracks_of(frame, ids, ended=(), *, camera=None, reset=None):
    segments = segments_of(frame, ids)
    return blank_tracks(
        len(ids),
        frame_index=frame,
        stamp_ns=frame * 33_000_000,
        ids=np.array(ids, np.int64),
        segments_px=segments,
        observed_px=segments + 0.25,
        scores=np.full(len(ids), 0.5, np.float32) + np.float32(frame) / 1000,
        ended_ids=np.array(ended, np.int64),
        camera=camera,
        reset=reset,
    )


def test_a_track_comes_out_as_it_went_in() -> None:
    history = TrackHistory()
    for frame, ids in enumerate([[1, 4], [1], [1, 4, 7]]):
        history.add(tracks_of(frame, ids, camera=CAMERA))
    assert history.ids.tolist() == [1, 4, 7]
    assert history.ids.dtype == np.int64
    track = history.observations_of(4)
    assert isinstance(track, Observations)
    assert (track.track_id, len(track), track.ended) == (4, 2, False)
    np.testing.assert_array_equal(track.frame_indices, [0, 2])
    np.testing.assert_array_equal(track.stamps_ns, [0, 66_000_000])
    assert track.frame_indices.dtype == track.stamps_ns.dtype == np.int64
    expected = np.concatenate([segments_of(0, [4]), segments_of(2, [4])])
    np.testing.assert_array_equal(track.segments_px, expected)
    np.testing.assert_array_equal(track.observed_px, expected + 0.25)
    assert track.segments_normalized is not None
    np.testing.assert_array_equal(track.segments_normalized, CAMERA.normalize(expected))
    np.testing.assert_allclose(track.scores, [0.5, 0.502])
    for array in (track.segments_px, track.observed_px, track.segments_normalized, track.scores):
        assert array.dtype == np.float32


def test_a_track_has_its_row_of_every_array() -> None:
    history, rng = TrackHistory(), np.random.default_rng(0)
    stream = [made_tracks(k, k, np.array([3, 5]), rng, camera=FISHEYE) for k in range(4)]
    for tracks in stream:
        history.add(tracks)
    track = history.observations_of(5)
    names = [one.name for one in (*FIELDS, *DERIVED) if hasattr(track, one.name)]
    assert {one.name for one in DERIVED if one.rows == "seen"} | {
        "observed_px",
        "observed_covariances",
        "measured",
    } <= set(names)
    for name in names:
        expected = np.stack([getattr(tracks, name)[1] for tracks in stream])
        np.testing.assert_array_equal(getattr(track, name), expected, strict=True)


def test_tracks_of_some_length_and_in_order() -> None:
    history = TrackHistory()
    for frame, ids in enumerate([[2, 9], [2, 9], [2], [1, 2]]):
        history.add(tracks_of(frame, ids))
    assert [track.track_id for track in history.tracks()] == [1, 2, 9]
    assert [track.track_id for track in history.tracks(at_least=2)] == [2, 9]
    assert not list(history.tracks(at_least=5))


def test_one_frame_without_a_camera_leaves_no_normalised_track() -> None:
    history = TrackHistory()
    history.add(tracks_of(0, [1], camera=CAMERA))
    history.add(tracks_of(1, [1, 2]))
    history.add(tracks_of(2, [3], camera=CAMERA))
    for track_id, known in ((1, False), (2, False), (3, True)):
        track = history.observations_of(track_id)
        assert {getattr(track, one.name) is not None for one in DERIVED if one.rows == "seen"} == {known}


def test_ended_tracks_are_handed_out_once_and_whole() -> None:
    history = TrackHistory()
    history.add(tracks_of(0, [1, 2, 3]))
    history.add(tracks_of(1, [1, 2], ended=(3, 99)))
    history.add(tracks_of(2, [1, 5], ended=(2, 5)))
    assert history.observations_of(3).ended
    assert not history.observations_of(1).ended
    ended = [(track.track_id, len(track), track.ended) for track in history.pop_ended()]
    assert ended == [(3, 1, True), (2, 2, True), (5, 1, True)], "5 ended in the frame it was seen in"
    assert history.pop_ended() == []
    assert history.ids.tolist() == [1]
    assert len(history) == 1


def test_a_reset_ends_every_track_before_it() -> None:
    history = TrackHistory()
    history.add(tracks_of(0, [1, 2]))
    history.add(tracks_of(1, [3], reset="the image size changed"))
    assert [track.track_id for track in history.pop_ended()] == [1, 2]
    assert history.ids.tolist() == [3]


def test_an_unknown_track_is_one_clear_error() -> None:
    history = TrackHistory(max_tracks=1)
    history.add(tracks_of(0, [1, 2]))
    for gone in (1, 77):
        with pytest.raises(InputError, match=f"track {gone} is not in the history"):
            history.observations_of(gone)
    assert len(history.observations_of(2)) == 1


@pytest.mark.parametrize("bound", ["max_frames", "max_tracks"])
def test_impossible_bounds_are_refused(bound: str) -> None:
    with pytest.raises(ConfigError, match="at least 1"):
        TrackHistory(**{bound: 0})


def test_ended_tracks_are_dropped_before_those_that_live(caplog: pytest.LogCaptureFixture) -> None:
    history = TrackHistory(max_tracks=3)
    history.add(tracks_of(0, [1, 2, 3]))
    history.add(tracks_of(1, [1, 3], ended=(2,)))
    history.add(tracks_of(2, [1, 4]))
    assert history.ids.tolist() == [1, 3, 4]
    assert history.dropped == 1
    history.add(tracks_of(3, [1, 4, 5]))
    assert history.ids.tolist() == [1, 4, 5]
    assert history.dropped == 2
    assert len(caplog.messages) == 1, "it is said once"


def test_a_record_does_not_hold_on_to_its_frame() -> None:
    tracks = tracks_of(0, [1])
    history = TrackHistory()
    history.add(tracks)
    tracks.segments_px[:] = -1
    track = history.observations_of(1)
    assert (track.segments_px >= 0).all()
    track.segments_px[:] = -1
    assert (history.observations_of(1).segments_px >= 0).all()


# Streams in the tracker's terms: per frame, how many new tracks come, and which of the live ones are seen and end.
FRAMES = st.lists(st.tuples(st.integers(0, 6), st.randoms(use_true_random=False), st.booleans()), max_size=40)


@given(frames=FRAMES, max_frames=st.integers(1, 5), max_tracks=st.integers(1, 12))
@settings(max_examples=100)
def test_the_bounds_hold_and_the_latest_is_kept(frames: list, max_frames: int, max_tracks: int) -> None:
    history = TrackHistory(max_frames, max_tracks)
    seen: dict[int, list[int]] = defaultdict(list)
    live: list[int] = []
    following = 0
    for frame, (new, chance, pop) in enumerate(frames):
        ids = sorted([k for k in live if chance.random() < 0.7] + list(range(following, following + new)))
        following += new
        ended = tuple(k for k in sorted({*live, *ids}) if chance.random() < 0.2)
        live = [k for k in {*live, *ids} if k not in ended]
        for track_id in ids:
            seen[track_id].append(frame)
        history.add(tracks_of(frame, ids, ended))

        assert len(history) == len(history.ids) <= max_tracks
        for track in history.tracks():
            assert 1 <= len(track) <= max_frames
            assert track.ended == (track.track_id not in live)
            # What is kept are the latest frames in which the track was seen.
            assert track.frame_indices.tolist() == seen[track.track_id][-len(track) :]
        if pop:
            assert all(track.track_id not in live for track in history.pop_ended())
            assert set(history.ids.tolist()) <= set(live)


def rows_of(frames: Iterable[LineTracks]) -> list[tuple[int, int]]:
    """Frame and track of every row."""
    return [(tracks.frame_index, track) for tracks in frames for track in tracks.ids.tolist()]


def with_history(stream: Iterable[LineTracks]) -> list[LineTracks]:
    confirmations = Confirmations()
    return [confirmations.add(tracks) for tracks in stream]


def assert_complete(stream: list[LineTracks]) -> None:
    """A backend that takes what is confirmed, and its history, gets every row of the tracks it gets, once."""
    given = [part for tracks in stream for part in (*tracks.history, tracks.take(tracks.confirmed))]
    ever = {track for tracks in stream for track in tracks.ids[tracks.confirmed].tolist()}
    rows = rows_of(given)
    assert len(rows) == len(set(rows))
    assert set(rows) == {(frame, track) for frame, track in rows_of(stream) if track in ever}


@given(frames=FRAMES, confirm_hits=st.integers(1, 4), resets=st.sets(st.integers(0, 39), max_size=2))
@settings(max_examples=200)
def test_a_confirmation_hands_over_all_that_was_seen_before(frames: list, confirm_hits: int, resets: set[int]) -> None:
    hits: dict[int, int] = defaultdict(int)
    live: list[int] = []
    following = 0
    stream = []
    for frame, (new, chance, _) in enumerate(frames):
        live = [] if frame in resets else live
        ids = sorted([k for k in live if chance.random() < 0.6] + list(range(following, following + new)))
        following += new
        for track_id in ids:
            hits[track_id] += 1
        ended = tuple(k for k in sorted(set(live) - set(ids)) if chance.random() < 0.2)
        live = [k for k in {*live, *ids} if k not in ended]
        tracks = tracks_of(frame, ids, ended, reset="a cut" if frame in resets else None)
        tracks.states[:] = [hits[k] >= confirm_hits for k in ids]
        stream.append(tracks)
    found = with_history(stream)
    assert_complete(found)
    for tracks, sent in zip(found, stream, strict=True):
        assert_same(tracks, sent)
        before = [part.frame_index for part in tracks.history]
        assert before == sorted(set(before)), "oldest first"
        assert max(before, default=-1) < tracks.frame_index
        for part in tracks.history:
            assert not part.confirmed.any()
            # it says of these tracks what its frame said
            whole = stream[part.frame_index]
            rows = np.searchsorted(whole.ids, part.ids)
            np.testing.assert_array_equal(part.segments_px, whole.segments_px[rows])
            assert (part.stamp_ns, part.camera, part.reset, part.history) == (whole.stamp_ns, whole.camera, None, ())
            assert len(part.ended_ids) == len(part.lost_ids) == 0


def test_the_tracker_hands_over_what_it_saw_before_it_confirmed() -> None:
    stream = [result.tracks for result in clip_results()]
    assert_complete(stream)
    assert stream[0].history == stream[1].history == ()
    first = stream[2].history
    assert [part.frame_index for part in first] == [0, 1]
    assert first[1].ids.tolist() == stream[2].ids[stream[2].confirmed].tolist()
    kept = stream[2].take(stream[2].ids == first[0].ids[0])
    assert rows_of(kept.history) == [(0, kept.ids[0]), (1, kept.ids[0])], "a part of a frame has that of its tracks"


def test_a_reset_leaves_no_history() -> None:
    stream = [tracks_of(0, [1]), tracks_of(1, [1], reset="a cut")]
    stream[1].states[:] = 1
    assert with_history(stream)[1].history == ()


def test_frames_are_not_held_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not for tracks whose end was in a message that was lost, nor by the histories of frames that are held."""
    monkeypatch.setattr("frontend.history.PATIENCE", 5)
    first, second = Confirmations(), Confirmations()
    frames = []
    for frame in range(20):
        tracks = tracks_of(frame, [frame, 1000 + frame // 2])  # one that is never seen again, one that is confirmed
        tracks.states[1] = frame % 2
        frames.append(weakref.ref(tracks))
        second.add(first.add(tracks))
        del tracks
    assert [frame() is not None for frame in frames] == [False] * 14 + [True] * 6

"""The history of tracks: what goes in comes out, per track, in bounded memory."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.errors import ConfigError, InputError
from frontend.camera.model import CameraModel
from frontend.history import Observations, TrackHistory
from tests.helpers.made_tracks import blank_tracks

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
    assert history.observations_of(1).segments_normalized is None
    assert history.observations_of(2).segments_normalized is None
    assert history.observations_of(3).segments_normalized is not None


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


def test_ended_tracks_are_dropped_before_those_that_live() -> None:
    history = TrackHistory(max_tracks=3)
    history.add(tracks_of(0, [1, 2, 3]))
    history.add(tracks_of(1, [1, 3], ended=(2,)))
    history.add(tracks_of(2, [1, 4]))
    assert history.ids.tolist() == [1, 3, 4]
    history.add(tracks_of(3, [1, 4, 5]))
    assert history.ids.tolist() == [1, 4, 5]


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
@settings(max_examples=100, deadline=None)
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

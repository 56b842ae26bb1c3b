"""`max_lines`: no more tracks than that, the best ones, from all over the image, and in the next frame the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.scenes import RenderedClip
from frontend import Frame, LineTracker, TrackerConfig
from frontend.tracking.selection import GRID, Selection, best
from frontend.tracks import LineTracks
from tests.helpers.made_tracks import blank_tracks
from tests.helpers.tracking_frames import line_set

SIZE = (640, 480)


def tracks_at(middles: object, lengths: object = 60.0, **given: object) -> LineTracks:
    """Upright lines, confirmed and stable, seen in 20 frames, unless given otherwise."""
    middles = np.asarray(middles, np.float32).reshape(-1, 2)
    half = np.zeros_like(middles)
    half[:, 1] = np.asarray(lengths) / 2
    count = len(middles)
    defaults = {
        "segments_px": np.stack([middles - half, middles + half], axis=1),
        "states": np.ones(count, np.uint8),
        "hits": np.full(count, 20, np.int32),
        "stable": np.ones(count, np.bool_),
        "consistency": np.ones(count, np.float32),
    }
    return blank_tracks(count, **defaults | given)


def chosen(tracks: LineTracks, count: int, taken: object = ()) -> list[int]:
    return best(tracks, SIZE, count, np.isin(tracks.ids, taken)).tolist()


def random_tracks(rng: np.random.Generator, count: int) -> LineTracks:
    return tracks_at(
        rng.uniform((-20, -20), (660, 500), (count, 2)),
        rng.uniform(0, 200, count),
        hits=rng.integers(1, 50, count).astype(np.int32),
        states=rng.integers(0, 2, count).astype(np.uint8),
        stable=rng.random(count) < 0.5,
        consistency=np.where(rng.random(count) < 0.2, np.nan, rng.uniform(0.3, 4, count)).astype(np.float32),
    )


@given(st.integers(0, 10**6), st.integers(0, 120), st.integers(1, 150))
@settings(max_examples=60)
def test_never_more_than_asked_for_and_confirmed_ones_first(seed: int, count: int, most: int) -> None:
    tracks = random_tracks(np.random.default_rng(seed), count)
    rows = chosen(tracks, most, tracks.ids[::3])
    assert rows == sorted(set(rows))
    assert len(rows) == min(most, count)
    left = np.delete(tracks.confirmed, rows)
    assert tracks.confirmed[rows].all() or not left.any()


@given(st.integers(0, 10**6), st.integers(1, 100))
@settings(max_examples=60)
def test_every_cell_has_its_first_line_before_any_has_its_second(seed: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.concatenate([rng.uniform((0, 0), SIZE, (60, 2)), rng.uniform((200, 100), (260, 180), (60, 2))])
    tracks = tracks_at(places, rng.uniform(10, 90, 120))
    cells = [tuple(cell) for cell in (tracks.segments_px.mean(axis=1) / SIZE * GRID).astype(int).tolist()]
    counts = [sum(cells[row] == cell for row in chosen(tracks, most)) for cell in set(cells)]
    there = [cells.count(cell) for cell in set(cells)]
    for here, all_here in zip(counts, there, strict=True):
        assert here >= min(max(counts) - 1, all_here), "a cell has one less than another only when it has no more"


def test_in_one_place_longer_steadier_and_older_lines_come_first():
    place = np.full((2, 2), 100)
    assert chosen(tracks_at(place, [30, 60]), 1) == [1]
    assert chosen(tracks_at(place, consistency=np.float32([2, 1])), 1) == [1]
    assert chosen(tracks_at(place, consistency=np.float32([3, np.nan])), 1) == [1], "nobody knows, which is no blame"
    assert chosen(tracks_at(place, hits=np.int32([3, 30])), 1) == [1]
    assert chosen(tracks_at(place, [90, 60], stable=np.array([False, True])), 1) == [1]
    assert chosen(tracks_at([[100, 100], [500, 400]], [120, 20], states=np.uint8([0, 1])), 1) == [1]


def test_equals_do_not_take_turns():
    """Lines that tremble, also over the borders of cells, and of which half are better now and half then."""
    rng = np.random.default_rng(4)
    middles, lengths = rng.uniform((0, 0), SIZE, (200, 2)), rng.uniform(40, 80, 200)
    selection, before, changes = Selection(60), None, []
    for _ in range(60):
        tracks = tracks_at(
            middles + rng.normal(0, 2, (200, 2)),
            lengths * rng.uniform(0.8, 1.2, 200),
            consistency=rng.uniform(0.8, 1.3, 200).astype(np.float32),
            stable=rng.random(200) < 0.9,
        )
        ids = set(selection.of(tracks, SIZE).ids.tolist())
        changes += [] if before is None else [len(ids - before)]
        before = ids
    assert np.mean(changes[10:]) < 0.3


def test_what_was_never_handed_out_is_not_reported_as_lost_or_ended():
    selection = Selection(2)
    tracks = tracks_at([[100, 100], [101, 100], [500, 400]], [60, 30, 60])
    first = selection.of(tracks, SIZE)
    assert (first.ids.tolist(), first.left_out) == ([0, 2], 1)
    lost = {"lost_ids": np.array([0, 1, 2]), "lost_segments_px": tracks.segments_px, "lost_frames": np.int32([4, 5, 6])}
    second = selection.of(replace(tracks.take([]), **lost), SIZE)
    assert (second.lost_ids.tolist(), second.lost_frames.tolist()) == ([0, 2], [4, 6])
    np.testing.assert_array_equal(second.lost_segments_px, tracks.segments_px[[0, 2]])
    third = selection.of(replace(tracks.take([]), ended_ids=np.array([0, 1, 2])), SIZE)
    assert third.ended_ids.tolist() == [0, 2]
    fourth = selection.of(replace(tracks.take([]), ended_ids=np.array([0])), SIZE)
    assert fourth.ended_ids.tolist() == [], "an id ends once"


def test_the_tracker_itself_goes_on_with_all_lines():
    """Those that it hands out are the same that it hands out without a limit, number by number."""
    few, every = LineTracker(TrackerConfig(max_lines=25)), LineTracker()
    for index, view in enumerate(RenderedClip(kind="indoor", motion="handheld", seed=3, frames=8)):
        frame, lines = Frame(index, view.stamp_ns, view.image), line_set(view.segments_px)
        some, everything = few.update(frame, lines), every.update(frame, lines)
        assert len(some) == 25
        assert some.left_out == len(everything) - 25 > 20
        assert everything.left_out == 0
        rows = np.searchsorted(everything.ids, some.ids)
        np.testing.assert_array_equal(some.segments_px, everything.segments_px[rows])
        np.testing.assert_array_equal(some.hits, everything.hits[rows])

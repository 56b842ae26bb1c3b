"""Tracks that no detected line takes: looked for on the edge map, told from their neighbours, and ended."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from airline import InputError
from frontend import Frame, LineTracker, LineTracks, TrackerConfig, TrackState
from tests.helpers.tracking_frames import drawn, edge_map, frame, line_set

LINES = np.array([[[20, 20], [180, 30]], [[30, 50], [30, 140]], [[60, 120], [150, 60]], [[50, 145], [180, 140]]])
SIZE = (200, 160)


def step(
    tracker: LineTracker, index: int, there: object, found: object, edges: object = None, image: object = None
) -> LineTracks:
    """One frame in which lines are `there`, the detector has `found` some, and the edge map has `edges`, or no map."""
    shown = drawn(index, np.asarray(there)) if image is None else Frame(index, index * 33_000_000, image)
    return tracker.update(shown, line_set(found), None if edges is None else edge_map(edges, SIZE))


def begin(frames: int = 4) -> LineTracker:
    """A tracker that has seen all lines in some frames."""
    tracker = LineTracker()
    for index in range(frames):
        step(tracker, index, LINES, LINES, LINES)
    return tracker


def test_a_track_goes_on_where_its_edge_does_and_is_lost_with_it():
    tracker = begin()
    for index in range(4, 14):
        tracks = step(tracker, index, LINES, LINES[:3], LINES)
        assert tracks.ids.tolist() == [0, 1, 2, 3]
        assert tracks.measured.tolist() == [False, False, False, True]
        assert tracks.line_indices.tolist() == [0, 1, 2, -1]
        assert tracks.hits.tolist() == [index + 1] * 4
        assert tracks.lost_ids.tolist() == []
        assert np.abs(tracks.observed_px[3] - LINES[3]).max() < 3.5
        assert np.abs(tracks.segments_px[3] - LINES[3])[:, 1].max() < 0.3
        assert 0.7 < tracks.scores[3] < 0.9, "the mean probability of its edge, between the pixels"
    for index in range(14, 18):
        tracks = step(tracker, index, LINES[:3], LINES[:3], LINES[:3])
        assert tracks.ids.tolist() == [0, 1, 2]
        assert tracks.lost_ids.tolist() == [3]
    again = step(tracker, 18, LINES, LINES, LINES)
    assert again.ids.tolist() == [0, 1, 2, 3]
    assert not again.measured.any()


@pytest.mark.parametrize(("share", "measured"), [(0.35, False), (0.7, True)])
def test_a_piece_of_an_edge_is_the_line_if_it_is_half_of_it(share, measured):
    piece = LINES[3, 0] + np.array([[0], [share]]) * (LINES[3, 1] - LINES[3, 0])
    tracks = step(begin(), 4, LINES, LINES[:3], [*LINES[:3], piece])
    assert tracks.measured.tolist() == [False] * 3 + [True] * measured


@pytest.mark.parametrize(("gate", "measured"), [(16.0, False), (1000.0, True)])
def test_an_edge_that_is_not_where_the_line_must_be_is_not_the_line(gate, measured):
    tracker = LineTracker(TrackerConfig(gate=gate))
    for index in range(8):
        step(tracker, index, LINES, LINES, LINES)
    tracks = step(tracker, 8, LINES, LINES[:3], [*LINES[:3], LINES[3] + [0, 1.4]])
    assert tracks.measured.tolist() == [False] * 3 + [True] * measured


def test_without_an_edge_map_nothing_is_measured():
    tracker = begin()
    for index in range(4, 7):
        tracks = step(tracker, index, LINES, LINES[:3])
        assert tracks.ids.tolist() == [0, 1, 2]
        assert not tracks.measured.any()


def test_what_was_not_seen_for_long_is_not_looked_for():
    tracker = begin(12)
    for index in range(12, 17):
        step(tracker, index, LINES[:3], LINES[:3], LINES[:3])
    tracks = step(tracker, 17, LINES, LINES[:3], LINES)
    assert tracks.lost_ids.tolist() == [3], "it waits for the detector"
    assert step(tracker, 18, LINES, LINES, LINES).ids.tolist() == [0, 1, 2, 3]


def test_a_track_is_not_measured_on_a_line_that_looks_otherwise_or_that_another_has():
    inverted = 255 - drawn(4, LINES).image
    tracks = step(begin(), 4, LINES, LINES[:0], LINES, image=inverted)
    assert tracks.ids.tolist() == [], "dark lines where there were bright ones"
    wall = cv2.fillConvexPoly(drawn(4, LINES).image, np.array([[50, 145], [180, 140], [180, 159], [50, 159]]), 200)
    tracks = step(begin(), 4, LINES, LINES[:3], LINES, image=wall)
    assert tracks.ids.tolist() == [0, 1, 2], "an edge where there was a line"
    pieces = np.concatenate([LINES[:3], [[[50, 145], [110, 142.7]], [[115, 142.5], [180, 140]]]])
    tracker = LineTracker()
    for index in range(4):
        step(tracker, index, LINES, pieces, LINES)
    joined = step(tracker, 4, LINES, LINES, LINES)
    assert len(joined.ids) == 4
    assert not joined.measured.any(), "the detected line lies there already"


def test_a_tentative_track_is_measured_and_confirmed_by_its_third_frame():
    tracker, states = LineTracker(), []
    for index in range(4):
        tracks = step(tracker, index, LINES, LINES[: 4 if index == 0 else 3], LINES)
        states.append(tracks.states[3])
        assert (tracks.states == TrackState.CONFIRMED).tolist() == (tracks.hits >= 3).tolist()
    assert states == [TrackState.TENTATIVE] * 2 + [TrackState.CONFIRMED] * 2


@pytest.mark.parametrize("edges", [False, True])
def test_a_line_that_jumps_onto_its_neighbour_is_another(edges):
    """The rest of the image rests, so the line four pixels beside cannot be the same."""
    tracker = begin(6)
    moved = np.concatenate([LINES[:3], LINES[3:] - [0, 4]])
    for index in range(6, 9):
        tracks = step(tracker, index, moved, moved, moved if edges else None)
        assert tracks.ids.tolist() == [0, 1, 2, 4]
        assert tracks.lost_ids.tolist() == [3]
    assert tracks.consistency.max() < 1.2


def test_a_resting_line_is_not_surer_than_its_pixels_allow():
    tracker = LineTracker()
    for index in range(40):
        tracks = step(tracker, index, LINES, LINES, LINES)
    fused, observed = tracks.covariances, tracks.observed_covariances
    assert (fused[:, 0, 0] > 0.12**2).all(), "the bias of an offset stays"
    assert (fused[:, 1, 1] > 0.5 * observed[:, 1, 1]).all(), "and half of an angle's variance"
    assert (np.linalg.eigvalsh(observed - fused) > 0).all()


def test_an_image_that_moves_as_a_whole_takes_its_lines_along():
    tracker = begin(6)
    image = np.ascontiguousarray(np.roll(drawn(6, LINES).image, -4, axis=0))
    tracks = step(tracker, 6, LINES, LINES - [0, 4], LINES - [0, 4], image=image)
    assert tracks.ids.tolist() == [0, 1, 2, 3]


def test_a_line_that_shakes_is_no_landmark():
    tracker = begin(8)
    for index in range(8, 18):
        shaken = np.concatenate([LINES[:3], LINES[3:] + [0, 0.45 * (-1) ** index]])
        tracks = step(tracker, index, LINES, shaken, LINES)
        print(tracks.consistency)
    assert tracks.ids.tolist() == [0, 1, 2, 3]
    assert tracks.consistency[:3].max() < 0.7
    assert tracks.consistency[3] > 1.5
    assert tracks.stable.tolist() == [True, True, True, False]


def two_sides(left: float, right: float, at: float = 100) -> np.ndarray:
    """(160, 200) picture of an upright edge between two grey levels, on a textured ground that rests."""
    image = drawn(0, LINES[:1]).image.astype(float) * 0.4
    image += np.where(np.arange(200) < at, left, right)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.7), 0, 255).astype(np.uint8)


def test_an_edge_whose_sides_have_swapped_goes_on_where_it_rests_and_ends_where_it_jumps():
    lines = np.array([[[99.5, 20], [99.5, 140]], [[20, 20], [180, 30]]])
    tracker = LineTracker()
    for index in range(16):
        change = 5 * np.clip(index - 4, 0, 8)
        tracks = step(tracker, index, lines, lines, image=two_sides(40 + change, 80 - change))
        assert tracks.ids.tolist() == [0, 1], "it is in its place, whatever it looks like by now"
    jumped = lines + [[[0.9, 0]], [[0, 0]]]
    after = step(tracker, 16, jumped, jumped, image=two_sides(80, 40, at=101))
    assert after.ids.tolist() == [1, 2]

    tracker = LineTracker()
    for index in range(16):
        step(tracker, index, lines, lines, image=two_sides(40, 80))
    after = step(tracker, 16, jumped, jumped, image=two_sides(40, 80, at=101))
    assert after.ids.tolist() == [0, 1], "such a jump alone is none"


@pytest.mark.parametrize("edges", [False, True])
def test_the_extent_follows_a_line_that_is_shorter_for_good(edges):
    tracker, shorter, ends = begin(6), LINES.astype(float), []
    shorter[0, 1] = [100, 25]
    for index in range(6, 11):
        tracks = step(tracker, index, shorter, shorter, shorter if edges else None)
        assert tracks.ids[0] == 0
        ends.append(tracks.segments_px[0, 1, 0])
    if edges:
        assert ends == pytest.approx([100] * 5, abs=6), "at once where no edge is"
    else:
        assert ends == pytest.approx([180, 180, 100, 100, 100], abs=1)


def test_a_gap_in_a_detection_does_not_shorten_a_line_that_has_its_edge():
    tracker, piece = begin(6), LINES.astype(float)
    piece[0, 1] = [100, 25]
    tracks = step(tracker, 6, LINES, piece, LINES)
    assert tracks.segments_px[0, 1, 0] == pytest.approx(180, abs=1)


def test_nothing_moves_while_there_is_nothing_to_see():
    tracker = begin()
    for index in range(4, 7):
        blind = step(tracker, index, [], [], [], image=np.zeros((160, 200), np.uint8))
        assert blind.lost_ids.tolist() == [0, 1, 2, 3]
        assert np.allclose(blind.lost_segments_px, LINES, atol=0.5)
    assert step(tracker, 7, LINES, LINES, LINES).ids.tolist() == [0, 1, 2, 3]
    assert tracker.update(frame(8, size=(180, 160)), line_set(LINES)).reset is not None


def test_of_two_tracks_that_lie_on_each_other_the_older_goes_on():
    tracker, ended = LineTracker(), []
    for index in range(20):
        away = max(0.4, 3 - 0.3 * max(0, index - 3))
        tracks = step(tracker, index, LINES, np.concatenate([LINES, LINES[3:] + [0, away]]), LINES)
        assert tracks.ids.tolist()[:4] == [0, 1, 2, 3]
        ended += tracks.ended_ids.tolist()
    assert 4 in ended
    assert tracks.ids.tolist() == [0, 1, 2, 3], "and does not begin again"


def test_a_line_that_is_detected_twice_is_one_track():
    tracker = LineTracker()
    for index in range(10):
        tracks = step(tracker, index, LINES, np.concatenate([LINES, LINES[::-1, ::-1] + [0, 0.4]]), LINES)
        assert tracks.ids.tolist() == [0, 1, 2, 3]


def test_lines_and_edges_that_cannot_be_are_refused():
    tracker = begin()
    with pytest.raises(InputError, match=r"\(160, 200\)"):
        tracker.update(drawn(4, LINES), line_set(LINES), edge_map(LINES, (100, 80)))
    with pytest.raises(InputError, match="finite"):
        step(tracker, 4, LINES, LINES + [np.nan, 0], LINES)
    with pytest.raises(InputError, match="uint8"):
        tracker.update(drawn(4, LINES), line_set(LINES), (255 * edge_map(LINES, SIZE)).astype(np.uint8))
    assert step(tracker, 4, LINES, LINES, LINES).ids.tolist() == [0, 1, 2, 3], "and change nothing"


def test_without_detected_lines_an_edge_map_is_enough():
    tracker = begin()
    for index in range(4, 8):
        tracks = step(tracker, index, LINES, LINES[:0], LINES)
        assert tracks.ids.tolist() == [0, 1, 2, 3]
        assert tracks.measured.all()


def test_short_lived_tracks_are_forgotten_by_the_setting():
    tracker = LineTracker(TrackerConfig(max_missed_tentative=1))
    step(tracker, 0, LINES, LINES, LINES)
    gone = [step(tracker, index, LINES[:3], LINES[:3], LINES[:3]).ended_ids.tolist() for index in range(1, 4)]
    assert gone == [[], [3], []]

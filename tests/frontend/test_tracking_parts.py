"""The tracker's parts, one by one: prediction, profiles, votes, assignment, fragments, borders."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment

from frontend.camera.model import CameraModel
from frontend.tracking.appearance import OFFSETS, side_profiles
from frontend.tracking.assignment import assign
from frontend.tracking.camera_motion import Motion
from frontend.tracking.extents import visible_parts
from frontend.tracking.flow import flow, working_image
from frontend.tracking.measurement import line_covariances
from frontend.tracking.overlap import LineFeatures, covered, overlap_votes, parents
from frontend.tracking.prediction import focal_of, predicted
from frontend.tracking.state import DEPTH, new_covariances
from frontend.tracking.table import TrackTable, new_tracks
from tests.helpers.tracking_frames import line_set, texture


def looks(segments: object, profiles: np.ndarray | None = None) -> LineFeatures:
    """Lines with descriptors of their angles, and the same profile for all unless given."""
    lines = line_set(np.array(segments))
    same = np.tile(np.float32([-0.5, -0.5, -0.5, -0.5, 0.5, 0.5, 0.5, 0.5]) / np.sqrt(2), (len(lines), 1))
    return LineFeatures(lines.segments, lines.descriptors, same if profiles is None else profiles)


def votes(tracks: LineFeatures, lines: LineFeatures, band: float = 4.0, parts: np.ndarray | None = None) -> np.ndarray:
    bands = np.full(len(tracks.segments), band, np.float32)
    parts = tracks.segments if parts is None else parts
    alike = np.full(len(bands), -1, np.float32)
    return overlap_votes(tracks, lines, bands, parts, alike, max_angle=np.deg2rad(20), min_agreement=0.5)


CAMERA = CameraModel(640, 480, 500.0, 500.0, 319.5, 239.5)


def tracks_of(lines: np.ndarray) -> TrackTable:
    """New tracks of such lines, px."""
    features = looks(lines)
    errors = line_covariances(features.segments, None)
    covariances = new_covariances(features.segments, errors, focal_of(CAMERA))
    return new_tracks(0, 0, features, covariances, np.full(len(lines), -1))


def some_lines(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform((150, 120), (500, 360), (count, 2, 2)).astype(np.float32)


def view(camera: CameraModel, rotation: np.ndarray) -> np.ndarray:
    """(480, 640) picture of a plane of soft noise, far away, from a turned camera."""
    plane, pixels = texture(3, (1000, 800)), np.float32(np.indices((480, 640))[::-1].transpose(1, 2, 0).reshape(-1, 2))
    places = moved_with(camera, rotation.T, pixels, flat=True) * 500 + (600, 500)
    return cv2.remap(plane, np.float32(places).reshape(480, 640, 2), None, cv2.INTER_LINEAR)


def moved_with(camera: CameraModel, rotation: np.ndarray, points: np.ndarray, flat: bool = False) -> np.ndarray:
    """Points (P, 2), px, from a turned camera, px, or on the plane z = 1."""
    rays = np.column_stack([camera.normalize(points), np.ones(len(points))]) @ rotation.T
    return rays[:, :2] / rays[:, 2:] if flat else camera.project(rays[:, :2] / rays[:, 2:])


@pytest.mark.parametrize("followed", [True, False])
@pytest.mark.parametrize(
    "camera", [CAMERA, replace(CAMERA, distortion="equidistant", coefficients=np.array([-0.1, 0.03, 0.0, 0.0]))]
)
def test_prediction_follows_a_turning_camera(camera, followed):
    turn = cv2.Rodrigues(np.array([0.02, 0.06, 0.05]))[0]
    before, after = (working_image(view(camera, rotation)) for rotation in (np.eye(3), turn))
    lines = some_lines(40)
    tracks = replace(tracks_of(lines), visible=np.full(40, followed))
    ahead = predicted(tracks, before, after, camera, (camera.width, camera.height), Motion())
    expected = moved_with(camera, turn, lines.reshape(-1, 2)).reshape(-1, 2, 2)
    assert np.abs(expected - lines).max() > 30
    away = np.abs(ahead.tracks.segments - expected).max()
    assert away < 0.6, "also lines without flow of their own: they move with the camera"
    assert ahead.tracks.visible.all() == ahead.tracks.visible.any() == followed
    assert np.abs(ahead.motion.translation).max() < 0.01
    assert ahead.trusted > 0.5
    assert (np.linalg.eigvalsh(ahead.tracks.covariances) > 0).all()


def test_depths_are_in_the_unit_of_the_scene():
    """What one camera sees is the same if all is twice as far away and it moves twice as far."""
    far, new = np.full((40, 2), 1.3, np.float32), tracks_of(some_lines(40))
    motion, dark = Motion(np.eye(3), np.array([0.05, 0.02, 0.01])), working_image(np.zeros((480, 640), np.uint8))
    kept = predicted(replace(new, depths=far), dark, dark, CAMERA, (640, 480), motion)
    scaled = predicted(replace(new, depths=far, hits=np.full(40, 3, np.int32)), dark, dark, CAMERA, (640, 480), motion)
    unit = 1.3 / (1 + 1.3 * 0.01)
    assert np.median(kept.tracks.depths) == pytest.approx(unit), "while the lines are new"
    assert np.median(scaled.tracks.depths) == pytest.approx(DEPTH)
    assert scaled.motion.translation == pytest.approx(unit * motion.translation)
    ratio = kept.tracks.covariances / scaled.tracks.covariances
    assert ratio[:, 2:, 2:] == pytest.approx(unit**2, rel=1e-4)
    assert ratio[:, :2, 2:] == pytest.approx(unit, rel=1e-4)
    assert np.array_equal(kept.tracks.segments, scaled.tracks.segments)


def test_flow_bears_a_jump_of_the_exposure():
    plane = texture(3, (400, 300))
    before, after = plane[100:400, 100:500], plane[103:403, 95:495]
    darker = (255 * (after / 255.0) ** 1.6 * 0.6).astype(np.uint8)
    points = np.random.default_rng(0).uniform((60, 60), (340, 240), (50, 2)).astype(np.float32)
    moved, consistent = flow(working_image(before), working_image(darker), points)
    assert consistent.mean() > 0.9
    assert np.abs(moved - points - [5, -3])[consistent].max() < 0.5


def step_image() -> np.ndarray:
    image = np.full((100, 120), 60, np.uint8)
    image[:, 60:] = 160
    return image


def test_profiles_of_a_step():
    down = np.array([[[59.5, 20], [59.5, 80]]], np.float32)  # x to the right is to the left of the direction
    profile = side_profiles(step_image(), down)[0]
    right_of_direction = OFFSETS < 0
    assert len(set(np.sign(profile[right_of_direction]))) == 1
    assert np.sign(profile[0]) == -np.sign(profile[-1])
    assert np.linalg.norm(profile) == pytest.approx(1, abs=0.01)
    assert np.allclose(side_profiles(step_image(), down[:, ::-1])[0], profile[::-1], atol=1e-6)


def test_votes_of_hand_made_pairs():
    track = looks([[[0, 0], [100, 0]]])
    lines = looks(
        [[[0, 0], [100, 0]], [[50, 2], [150, 2]], [[0, 0], [0, 100]], [[0, 50], [100, 50]], [[0, 1], [50, 1]]]
    )
    # cover (35 % for the share of the shorter, 65 % for that of the longer) times closeness, squared
    expected = np.square([1, 0.5 * 0.5, 0, 0, (0.35 + 0.65 * 0.5) * 0.75])
    assert votes(track, lines)[0] == pytest.approx(expected, abs=1e-5)


def test_votes_prefer_the_line_that_looks_alike():
    step = np.float32([-1, -1, -1, -1, 1, 1, 1, 1]) / np.float32(np.sqrt(8))
    track = looks([[[0, 0], [100, 0]]], step[None])
    lines = looks([[[0, 2], [100, 2]], [[0, -2], [100, -2]]], np.stack([step, -step]))
    alike, opposite = votes(track, lines)[0]
    assert alike > 0.2
    assert opposite == pytest.approx(0, abs=1e-6)


@settings(max_examples=100)
@given(st.integers(0, 150), st.integers(0, 170), st.sampled_from([0.005, 0.02, 0.2, 1.0]), st.integers(0, 999))
def test_assignment_is_the_best_of_all(rows, columns, density, seed):
    rng, least = np.random.default_rng(seed), 0.1
    matrix = rng.random((rows, columns)).astype(np.float32) * (rng.random((rows, columns)) < density)
    chosen = assign(matrix, least)
    taken = chosen[chosen >= 0]
    assert len(set(taken.tolist())) == len(taken)
    pairs = matrix[np.flatnonzero(chosen >= 0), taken]
    assert (pairs >= least).all()
    worth = np.where(matrix >= least, matrix, 0)
    assert pairs.sum() == pytest.approx(worth[linear_sum_assignment(worth, maximize=True)].sum(), rel=1e-5)


def test_fragments_lie_on_an_older_line_but_not_beside_the_piece_that_goes_on():
    whole = np.array([[[0, 0], [100, 0]]], np.float32)
    goes_on = [[0, 0], [60, 0]]
    lines = [
        [[65, 0], [100, 0]],
        [[20, 0.5], [50, 0.5]],
        [[65, 6], [100, 6]],
        [[90, 0], [160, 0]],
        [[65, -20], [100, 20]],
    ]
    assert parents(np.array([goes_on, *lines], np.float32), whole).tolist() == [-1, 0, -1, -1, -1, -1]
    assert parents(np.array(lines, np.float32), whole[:0]).tolist() == [-1] * 5


def test_lines_that_lie_on_others_are_covered():
    lines = np.array([[[0, 0], [100, 0]]], np.float32)
    found = [[[90, 0.5], [20, 0.5]], [[0, 1.5], [100, 1.5]], [[70, 0], [160, 0]], [[0, 9], [90, 9]], [[5, 9], [80, 9]]]
    assert covered(np.array(found, np.float32), lines).tolist() == [True, False, False, False, True]


@settings(max_examples=100)
@given(arrays(np.float32, (4, 2, 2), elements=st.floats(-60, 160, width=32)))
def test_the_visible_part_is_what_is_inside(segments):
    low, high, lengths = visible_parts(segments, (100, 80))
    share = np.linspace(0, 1, 2001)[:, None]
    for n, segment in enumerate(segments.astype(np.float64)):
        points = segment[0] + share * (segment[1] - segment[0])
        inside = ((points >= -0.5) & (points <= (99.5, 79.5))).all(axis=1)
        whole = np.linalg.norm(segment[1] - segment[0])
        assert lengths[n] == pytest.approx(inside.mean() * whole, abs=0.01 * whole + 0.05)
        if lengths[n] > 1:
            assert share[inside][[0, -1], 0] == pytest.approx([low[n], high[n]], abs=0.001)
            assert lengths[n] == pytest.approx((high[n] - low[n]) * whole)
        elif lengths[n] == 0:
            assert (low[n], high[n]) == (0, 1)

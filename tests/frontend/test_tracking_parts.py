"""The tracker's parts, one by one: motion, profiles, votes, assignment, fusion, fragments, borders."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment

from frontend.tracking.appearance import OFFSETS, side_profiles
from frontend.tracking.assignment import assign
from frontend.tracking.fusion import clip, fuse
from frontend.tracking.motion import predict_segments, warp, working_image
from frontend.tracking.overlap import LineFeatures, overlap_votes, parents
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


def test_prediction_follows_a_turning_camera():
    plane = texture(3, (640, 480))[100:-100, 100:-100]
    camera = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
    turn = camera @ cv2.Rodrigues(np.array([0.02, 0.06, 0.05]))[0] @ np.linalg.inv(camera)
    seen = cv2.warpPerspective(plane, turn, (640, 480), borderMode=cv2.BORDER_REFLECT)
    lines = np.random.default_rng(0).uniform((150, 120), (500, 360), (40, 2, 2)).astype(np.float32)
    moved = predict_segments(working_image(plane), working_image(seen), lines, np.zeros(40, np.bool_), np.eye(3))
    expected = warp(turn, lines)
    assert np.abs(expected - lines).max() > 30
    assert np.abs(moved.segments - expected).max() < 2.5, "lines without flow of their own follow the whole image"
    assert not moved.followed.any()


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


@settings(max_examples=100, deadline=None)
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


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_fusion_is_the_kalman_update(seed):
    """Against the textbook update in a frame that lies along the prediction."""
    rng = np.random.default_rng(seed)
    length, lever = rng.uniform(20, 100), rng.uniform(-15, 15)
    offset, turn = rng.normal(0, 0.5), rng.normal(0, 0.02)
    before, noise = (np.array([[a, c], [c, b]]) for a, b, c in ((0.3, 2e-4, 1e-3), (0.2, 3e-4, -2e-3)))
    predicted = np.array([[-length / 2, 0], [length / 2, 0]])
    arm = np.array([np.cos(turn), np.sin(turn)]) * length / 2
    measured = np.array([lever, offset]) + np.stack([-arm, arm])
    carried = np.array([[1, lever], [0, 1]]) @ before @ np.array([[1, lever], [0, 1]]).T
    gain = carried @ np.linalg.inv(carried + noise)
    shift, angle = gain @ [offset, turn]
    after = (np.eye(2) - gain) @ carried
    place = np.array([500.0, 400.0])
    heading = rng.uniform(0, 2 * np.pi)
    spin = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    args = [(predicted @ spin.T + place)[None], before[None], (measured @ spin.T + place)[None], noise[None]]
    fused, covariance = fuse(*(np.float32(a) for a in args), (1000, 800))
    back = (fused[0].astype(np.float64) - place) @ spin
    delta = back[1] - back[0]
    assert np.arctan2(delta[1], delta[0]) == pytest.approx(angle, abs=2e-4)
    at_lever = back[0, 1] + (lever - back[0, 0]) * delta[1] / delta[0]
    assert at_lever == pytest.approx(shift, abs=0.02)
    moved = np.array([[1, back[:, 0].mean() - lever], [0, 1]])
    assert np.allclose(covariance[0], moved @ after @ moved.T, rtol=0.05, atol=2e-4)


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


@settings(max_examples=100, deadline=None)
@given(arrays(np.float32, (4, 2, 2), elements=st.floats(-60, 160, width=32)))
def test_clipping_keeps_what_is_inside(segments):
    clipped, lengths = clip(segments, (100, 80))
    share = np.linspace(0, 1, 2001)[:, None]
    for segment, part, length in zip(segments.astype(np.float64), clipped, lengths, strict=True):
        points = segment[0] + share * (segment[1] - segment[0])
        inside = ((points >= -0.5) & (points <= (99.5, 79.5))).all(axis=1)
        whole = np.linalg.norm(segment[1] - segment[0])
        assert length == pytest.approx(inside.mean() * whole, abs=0.01 * whole + 0.05)
        if length > 1:
            assert ((part >= -0.51) & (part <= (99.51, 79.51))).all()
            assert (part[1] - part[0]) @ (segment[1] - segment[0]) > 0

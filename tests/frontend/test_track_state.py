"""A track's filter, against lines in space that were made up."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frontend.tracking.camera_motion import Motion
from frontend.tracking.config import TrackerConfig
from frontend.tracking.measurement import line_covariances
from frontend.tracking.state import (
    DEPTH,
    DEPTH_WALK,
    MOVING,
    PER_PIXEL,
    STILL,
    innovations,
    line_part,
    new_covariances,
    predict,
    slide,
    update,
)

FOCAL = 400.0
MIDDLE = (319.5, 239.5)
MOTION = Motion(cv2.Rodrigues(np.array([0.004, -0.006, 0.01]))[0], np.array([0.03, -0.02, 0.04]))
seeds = st.integers(0, 10**6)


def no_flow(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros((count, 2, 2)), np.zeros((count, 2, 2)), np.zeros((count, 2), np.bool_)


def to_plane(pixels: np.ndarray) -> np.ndarray:
    return (pixels.astype(np.float64) - MIDDLE) / FOCAL


def from_plane(plane: np.ndarray) -> np.ndarray:
    return plane * FOCAL + MIDDLE


def moved(planes: np.ndarray, depths: np.ndarray, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Ends (N, 2, 2) and their inverse depths (N, 2) from the moved camera, by way of points in space."""
    points = np.concatenate([planes, np.ones((*depths.shape, 1))], axis=2) / depths[:, :, None]
    points = points @ motion.rotation.T + motion.translation
    return points[:, :, :2] / points[:, :, 2:], 1 / points[:, :, 2]


def normals(segments: np.ndarray) -> np.ndarray:
    delta = segments[:, 1] - segments[:, 0]
    return np.stack([-delta[:, 1], delta[:, 0]], axis=1) / np.hypot(*delta.T)[:, None]


def lines(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Segments in the image, px, and the inverse depths of their ends, about as far apart as the filter expects."""
    middle, angle = rng.uniform((120, 100), (520, 380), (count, 2)), rng.uniform(0, 2 * np.pi, count)
    length = rng.uniform(30, 140, count)
    arm = np.stack([np.cos(angle), np.sin(angle)], axis=1) * length[:, None] / 2
    whole, slope = rng.uniform(0.4, 1.8, count), rng.normal(0, 0.15, count)
    return np.stack([middle - arm, middle + arm], axis=1), np.stack([whole - slope, whole + slope], axis=1)


def noisy(rng: np.random.Generator, segments: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Measured lines: pieces of the true ones with errors of offset and angle of such covariances."""
    delta = segments[:, 1:] - segments[:, :1]
    places = np.stack([rng.uniform(-0.1, 0.15, len(delta)), rng.uniform(0.85, 1.1, len(delta))], axis=1)
    pieces = segments[:, :1] + places[:, :, None] * delta
    offset, angle = (rng.normal(0, np.sqrt(errors[:, k, k])) for k in range(2))
    arm = np.hypot(*(pieces[:, 1] - pieces[:, 0]).T) / 2
    shift = np.stack([offset - arm * np.tan(angle), offset + arm * np.tan(angle)], axis=1)
    return pieces + shift[:, :, None] * normals(pieces)[:, None]


def random_states(seed: int, count: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    segments, depths = lines(rng, count)
    root = rng.normal(0, 1, (count, 4, 4)) * (0.5, 0.5, 0.2, 0.2)
    return segments, depths, root.transpose(0, 2, 1) @ root + 1e-3 * np.eye(4)


@pytest.mark.parametrize("seed", range(6))
def test_lines_in_space_are_learned_and_their_errors_known(seed):
    """200 lines that move as the filter takes them to, seen from a camera that moves by 5 % of the depth."""
    rng, count = np.random.default_rng(seed), 200
    truth, true_depths = lines(rng, count)
    errors = line_covariances(np.float32(truth), np.full(count, 0.4, np.float32))
    segments = noisy(rng, truth, errors)
    depths, covariances = np.full((count, 2), DEPTH), new_covariances(np.float32(segments), errors, FOCAL)
    squares = []
    for _ in range(10):
        planes, true_depths = moved(to_plane(truth), true_depths, MOTION)
        shift = np.abs(from_plane(planes) - truth).max(axis=(1, 2))
        still = STILL + MOVING * np.minimum(1, shift) + PER_PIXEL * shift
        truth = from_plane(planes) + rng.normal(0, 1, (count, 2, 1)) * still[:, None, None] * normals(planes)[:, None]
        true_depths += rng.normal(0, DEPTH_WALK, (count, 2))
        unknown = np.zeros((count, 2)), no_flow(count)
        planes, depths, covariances, _ = predict(
            to_plane(segments), depths, covariances, *unknown, MOTION, FOCAL, flow_noise=0.15
        )
        errors = line_covariances(np.float32(truth), np.full(count, 0.4, np.float32))
        offsets, spread, square, _ = innovations(from_plane(planes), covariances, noisy(rng, truth, errors), errors)
        squares.append(square)
        segments, depths, covariances = update(from_plane(planes), depths, covariances, offsets, spread)
    good = np.max(squares, axis=0) < TrackerConfig().gate
    assert good.mean() > 0.96, "the tracker ends the others"
    assert 0.8 < np.mean(np.array(squares)[1:, good]) / 2 < 1.15, "innovations are as large as expected"
    wrong = (depths - true_depths)[good]
    assert np.median(np.abs(wrong / true_depths[good])) < 0.04
    normalised = np.einsum("nk,nkl,nl->n", wrong, np.linalg.inv(covariances[good, 2:, 2:]), wrong) / 2
    assert 0.7 < normalised.mean() < 1.8, "and so are errors of depth"


@settings(max_examples=50)
@given(seeds)
def test_prediction_is_the_projection_and_its_covariance_that_of_the_linearised_one(seed):
    segments, depths, covariances = random_states(seed)
    planes, count = to_plane(segments), len(segments)
    unknown = np.zeros((count, 2)), no_flow(count)
    ahead, deep, grown, across = predict(planes, depths, covariances, *unknown, MOTION, FOCAL, flow_noise=0.15)
    true_planes, true_depths = moved(planes, depths, MOTION)
    assert np.allclose(ahead, true_planes, atol=1e-12)
    assert np.allclose(deep, true_depths, atol=1e-12)
    aside = np.abs(((true_planes - planes) * normals(true_planes)[:, None]).sum(axis=2).mean(axis=1)) * FOCAL
    assert np.allclose(across, aside, atol=1e-6)
    for n in range(count):
        jacobian = np.zeros((4, 4))
        for k in range(2):
            step = np.zeros((2, 2))
            step[k] = 1e-6
            more = moved(planes[n : n + 1], depths[n : n + 1] + step[:, 0], MOTION)[0]
            jacobian[k, 2 + k] = (more[0, k] - true_planes[n, k]) @ normals(true_planes)[n] * FOCAL / 1e-6
            jacobian[2 + k, 2 + k] = jacobian[k, k] = true_depths[n, k] / depths[n, k]
        moves = np.abs(true_planes[n] - planes[n])
        shift = FOCAL * np.hypot(*moves.T).max()
        walk = STILL + MOVING * min(1, shift) + PER_PIXEL * shift
        noise = np.diag([walk**2, walk**2, DEPTH_WALK**2, DEPTH_WALK**2])
        assert np.allclose(grown[n], jacobian @ covariances[n] @ jacobian.T + noise, rtol=1e-4, atol=1e-6)


def test_flow_tells_depths_unless_it_is_of_something_else():
    planes = to_plane(np.array([[[300.0, 100], [340, 300]]]))
    true_depths, sideways = np.array([[1.6, 1.6]]), Motion(np.eye(3), np.array([0.05, 0, 0]))
    start = new_covariances(np.float32(from_plane(planes)), line_covariances(np.float32(planes * FOCAL), None), FOCAL)
    places = np.array([[0.25, 0.75]])
    points = planes[:, :1] + places[:, :, None] * (planes[:, 1:] - planes[:, :1])
    true_points, _ = moved(points, true_depths, sideways)
    known = np.ones((1, 2), np.bool_)

    def after(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return predict(planes, np.full((1, 2), DEPTH), start, places, (points, flow, known), sideways, FOCAL, 0.15)[1:3]

    depths, covariances = after(true_points)
    assert depths == pytest.approx(true_depths, rel=0.05)
    assert np.sqrt(covariances[0, 2, 2]) < 0.05
    elsewhere, unchanged = after(true_points + np.array([80, 0]) / FOCAL)
    assert elsewhere == pytest.approx(DEPTH)
    assert unchanged[0, 2, 2] == pytest.approx(start[0, 2, 2] + DEPTH_WALK**2)


@settings(max_examples=100)
@given(seeds)
def test_update_is_the_kalman_update(seed):
    """Against the textbook, with the errors of a measured line carried to where the ends of the state are."""
    rng = np.random.default_rng(seed)
    segments, depths, covariances = random_states(seed)
    errors = line_covariances(np.float32(segments), rng.uniform(0.2, 1.0, len(segments)).astype(np.float32))
    measured = noisy(rng, segments, errors)
    both = rng.uniform(-0.9, 0.9, len(segments)) * np.sqrt(errors[:, 0, 0] * errors[:, 1, 1])
    errors[:, 0, 1] = errors[:, 1, 0] = both
    offsets, spread, squares, away = innovations(segments, covariances, measured, errors)
    after, deep, smaller = update(segments, depths, covariances, offsets, spread)
    assert np.array_equal(smaller, smaller.transpose(0, 2, 1))
    assert (np.linalg.eigvalsh(smaller) > 0).all()
    H = np.eye(2, 4)
    for n, (old, line) in enumerate(zip(segments, measured, strict=True)):
        normal = normals(segments)[n]
        delta = line[1] - line[0]
        places = ((old - line.mean(axis=0)) @ delta) / np.hypot(*delta)  # of the state's ends along the measured line
        arms = np.stack([np.ones(2), places], axis=1)
        R = arms @ errors[n] @ arms.T
        S = H @ covariances[n] @ H.T + R
        beside = normals(measured)[n]
        assert offsets[n] == pytest.approx((line[0] - old) @ beside / (normal @ beside), abs=1e-6)
        assert np.allclose(spread[n], S, rtol=1e-5)
        assert squares[n] == pytest.approx(offsets[n] @ np.linalg.solve(S, offsets[n]), rel=1e-4)
        assert away[n] == pytest.approx(np.abs((line - old[0]) @ normal).max(), abs=1e-6)
        K = covariances[n] @ H.T @ np.linalg.inv(S)
        change = K @ offsets[n]
        assert np.allclose(after[n], old + change[:2, None] * normal, atol=1e-5)
        assert np.allclose(deep[n], depths[n] + change[2:], atol=1e-6)
        assert np.allclose(smaller[n], (np.eye(4) - K @ H) @ covariances[n], atol=1e-6)


@settings(max_examples=100)
@given(seeds, st.floats(-0.5, 0.4), st.floats(0.6, 1.5))
def test_ends_slide_along_the_line_and_back(seed, low, high):
    segments, depths, covariances = random_states(seed)
    lows, highs = np.full(len(segments), low), np.full(len(segments), high)
    there = slide(segments, depths, covariances, lows, highs)
    for place, end in ((low, 0), (high, 1)):
        weights = np.array([1 - place, place])
        assert np.allclose(there[0][:, end], weights @ segments)
        assert np.allclose(there[1][:, end], depths @ weights)
        assert np.allclose(there[2][:, end, end], weights @ covariances[:, :2, :2] @ weights)
        assert np.allclose(there[2][:, 2 + end, 2 + end], weights @ covariances[:, 2:, 2:] @ weights)
    back = slide(*there, -lows / (highs - lows), (1 - lows) / (highs - lows))
    for before, after in zip((segments, depths, covariances), back, strict=True):
        assert np.allclose(before, after, atol=1e-6 * np.abs(before).max())


@settings(max_examples=100)
@given(seeds, st.floats(2, 6))
def test_errors_stay_positive_where_ends_come_back_from_far_away(seed, power):
    """The table keeps float32, which of large errors leaves nothing of what belongs to the middle."""
    segments, depths, covariances = random_states(seed)
    far = np.full(len(segments), 10.0**power)
    away = slide(segments, depths, covariances, far, far + 1)
    rounded = [np.float32(values).astype(np.float64) for values in away]
    near = slide(*rounded, -far, 1 - far)[2]
    assert (np.linalg.eigvalsh(near[:, :2, :2]) > 0).all()
    assert (np.linalg.eigvalsh(near[:, 2:, 2:]) > 0).all()


@settings(max_examples=100)
@given(seeds)
def test_ends_and_offset_with_angle_are_two_names_of_one_error(seed):
    rng = np.random.default_rng(seed)
    segments = np.float32(lines(rng, 5)[0])
    length = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    offset, correlation = rng.uniform(0.05, 1, 5), rng.uniform(-0.9, 0.9, 5)
    angle = offset * rng.uniform(1, 6, 5) / length
    both = correlation * offset * angle
    errors = np.array([[offset**2, both], [both, angle**2]]).transpose(2, 0, 1)
    state = new_covariances(segments, np.float32(errors), FOCAL)
    assert (np.linalg.eigvalsh(state) > 0).all()
    for side in (-1, 1):  # an end is half the length from the middle
        variance = offset**2 + side * length * both + length**2 / 4 * angle**2
        assert np.allclose(state[:, max(side, 0), max(side, 0)], variance, rtol=1e-3)
    part = line_part(segments, state)
    assert np.array_equal(part, part.transpose(0, 2, 1))
    scale = np.array([[offset**2, offset * angle], [offset * angle, angle**2]]).transpose(2, 0, 1)
    assert np.allclose(part / scale, errors / scale, atol=2e-3)

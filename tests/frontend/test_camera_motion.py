"""The camera's motion from points, against motions that were made up."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from frontend.tracking.camera_motion import LEAST_POINTS, Motion, camera_motion

NOISE = 0.15 / 400  # a sixth of a pixel at a focal length of 400 px
UNKNOWN = 0.7  # standard deviation of an inverse depth that is not known
FIELD = (0.7, 0.5)  # half the image, on the plane z = 1
SEEDS = range(20)

Points = tuple[np.ndarray, np.ndarray, np.ndarray]  # before, after, inverse depths


def seen(before: np.ndarray, depths: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    moved = np.column_stack([before, np.ones(len(before))]) @ rotation.T + depths[:, None] * translation
    return moved[:, :2] / moved[:, 2:]


def turned(*vector: float) -> np.ndarray:
    return cv2.Rodrigues(np.array(vector))[0]


def scene(seed: int, motion: Motion, points: int = 120, wrong: float = 0.0) -> Points:
    """Points of all depths in any order, a share of which is anywhere afterwards."""
    rng = np.random.default_rng(seed)
    before, depths = rng.uniform(np.negative(FIELD), FIELD, (points, 2)), np.exp(rng.normal(0, 0.5, points))
    after = seen(before, depths, motion.rotation, motion.translation) + rng.normal(0, NOISE, (points, 2))
    outliers = rng.random(points) < wrong
    after[outliers] = rng.uniform(np.negative(FIELD), FIELD, (outliers.sum(), 2))
    return before, after, depths


def found(points: Points, error: float, previous: Motion | None = None) -> Motion:
    """The motion of points whose inverse depths err by so much; if they are not known all are taken to be 1."""
    before, after, depths = (np.float32(values) for values in points)
    known = np.ones_like(depths) if error == UNKNOWN else depths
    return camera_motion(before, after, known, np.full_like(depths, error), NOISE, previous or Motion())


def over_noise(motion: Motion, truth: Motion, points: Points) -> float:
    """Squared error over the least variance that any estimator from such points can have, per unknown."""
    before, _, depths = points

    def image(x: np.ndarray) -> np.ndarray:
        return seen(before, depths, turned(*x[:3]) @ truth.rotation, truth.translation + x[3:]).ravel()

    jacobian = np.stack([(image(step) - image(-step)) / 2e-5 for step in 1e-5 * np.eye(6)], axis=1)
    turn = cv2.Rodrigues(motion.rotation @ truth.rotation.T)[0].ravel()
    error = np.concatenate([turn, motion.translation - truth.translation])
    return float(np.sum((jacobian @ error) ** 2)) / NOISE**2 / 6


def degrees_between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_points_of_known_depth_give_the_motion_to_within_their_noise(wrong):
    truth, ratios, errors = Motion(turned(0.02, -0.03, 0.01), np.array([0.05, 0.02, 0.08])), [], []
    for seed in SEEDS:
        points = scene(seed, truth, wrong=wrong)
        motion = found(points, 5e-4)
        ratios.append(over_noise(motion, truth, points))
        errors.append(motion.error)
    assert np.mean(ratios) < (2.5 if wrong else 1.6), "1 is what the noise allows"
    assert 0.8 < np.mean(errors) < (1.5 if wrong else 1.2), "the error is in units of the noise"


def test_a_turn_is_found_without_depths():
    truth = Motion(turned(0.03, -0.05, 0.02))
    for seed in SEEDS:
        motion = found(scene(seed, truth), UNKNOWN)
        assert np.linalg.norm(cv2.Rodrigues(motion.rotation @ truth.rotation.T)[0]) < 4 * NOISE
        assert np.linalg.norm(motion.translation) < 4 * NOISE


@pytest.mark.parametrize("translation", [(0, 0, 0.08), (0.01, 0, 0.03), (0, 0.01, -0.08), (0.06, 0.01, 0)])
def test_a_shift_without_depths_gives_the_epipole(translation):
    truth = Motion(turned(0.002, 0.005, 0), np.array(translation))
    for seed in SEEDS:
        motion = found(scene(seed, truth), UNKNOWN)
        assert degrees_between(motion.translation, truth.translation) < 2.0
        length = np.linalg.norm(motion.translation) / np.linalg.norm(truth.translation)
        assert 0.4 < length < 1.6, "in depths of the scene"
        assert np.linalg.norm(cv2.Rodrigues(motion.rotation @ truth.rotation.T)[0]) < 4 * NOISE


@pytest.mark.parametrize("translation", [(0, 0, 0.1), (0.05, 0.02, 0.05), (-0.05, 0.02, -0.05)])
def test_a_jerk_is_followed(translation):
    before, after = Motion(np.eye(3), np.array([0.3, 0, 0])), Motion(turned(0.005, -0.08, 0.03), np.array(translation))
    for seed in SEEDS:
        motion = found(scene(seed, after), UNKNOWN, before)
        assert np.linalg.norm(cv2.Rodrigues(motion.rotation @ after.rotation.T)[0]) < 4 * NOISE
        assert degrees_between(motion.translation, after.translation) < 2.0


def test_a_motion_that_no_points_make_is_not_believed():
    assert found(scene(0, Motion(), wrong=1.0), UNKNOWN).error > 3


def test_fewer_points_than_a_motion_needs_leave_the_previous_one():
    previous, points = Motion(turned(0, 0.01, 0), np.array([0.02, 0, 0])), scene(0, Motion(), LEAST_POINTS)
    assert found(tuple(values[1:] for values in points), UNKNOWN, previous) is previous
    assert np.abs(found(points, UNKNOWN, previous).rotation - np.eye(3)).max() < 0.004


def test_points_in_one_place_stop_nothing():
    """Of a turn about them they say nothing at all."""
    before, after, depths = np.zeros((LEAST_POINTS, 2)), np.full((LEAST_POINTS, 2), 1e-3), np.ones(LEAST_POINTS)
    motion = found((before, after, depths), UNKNOWN)
    assert seen(before, depths, motion.rotation, motion.translation) == pytest.approx(after, abs=NOISE)

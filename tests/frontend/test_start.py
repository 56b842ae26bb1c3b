"""The start of a map: made worlds with exact lines and noise, rendered clips, and what must wait."""

from __future__ import annotations

import importlib
import sys
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.scenes import RenderedClip
from airline.scenes.camera import rotation
from frontend import CameraModel, LineFrontend, LineTracker, LineTracks, TrackerConfig
from frontend.sources.scene import SceneSource
from frontend.start import Begun, start
from frontend.starting.agreement import costs, residuals
from frontend.starting.candidates import candidates, inverse_depths
from frontend.starting.views import Seen, View, corners
from frontend.tracks import TrackState
from tests.helpers.made_tracks import blank_tracks

Array = NDArray[np.float64]
CAMERA = CameraModel(640, 480, 500.0, 500.0, 319.5, 239.5)
NOISE = 0.2  # px, of line ends and points
FORWARD, SIDEWAYS = np.array([0.0, 0.0, 0.06]), np.array([0.06, 0.0, 0.0])


def walk(count: int, step: Array = FORWARD, turn: float = 0.0) -> Array:
    """(count, 3, 4) world_from_camera: a step and a turn about the vertical, radians, for each frame."""
    aligned = rotation(0.0, 0.0, 0.0).T  # x right, y down, z forward at first
    return np.stack([np.column_stack([aligned @ rotation(-turn * k, 0.0, 0.0), k * step]) for k in range(count)])


@cache
def boxes(seed: int = 0) -> tuple[Array, Array]:
    """(N, 2, 3) the edges of boxes before the camera, and (P, 3) points."""
    rng = np.random.default_rng(seed)
    corner = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    edges = np.array([(a, b) for a in range(8) for b in range(a) if np.abs(corner[a] - corner[b]).sum() == 1])
    places = rng.uniform((-2.5, -1.5, 3.5), (1.5, 0.5, 8.0), (8, 3))
    sizes = rng.uniform(0.4, 1.2, (8, 3))
    return (places[:, None] + corner * sizes[:, None])[:, edges].reshape(-1, 2, 3), rng.uniform(
        (-3, -2, 3), (3, 2, 9), (60, 3)
    )


def seen_from(
    poses: Array, lines: int = 96, points: int = 0, seed: int = 0, camera: CameraModel | None = CAMERA
) -> list[LineTracks]:
    """What cameras see of lines and points, with noise: those before them and, by one end at least, in the image."""
    rng = np.random.default_rng(seed)
    ends, dots = boxes()
    frames = []
    for index, pose in enumerate(poses):
        local, dot = ((space - pose[:, 3]) @ pose[:, :3] for space in (ends[:lines], dots[:points]))
        px, dot_px = ((CAMERA.matrix @ (v / v[..., 2:])[..., None])[..., :2, 0] for v in (local, dot))
        inside = ((px > 0) & (px < (640, 480))).all(axis=2).any(axis=1) & (local[:, :, 2] > 0.2).all(axis=1)
        there = ((dot_px > 0) & (dot_px < (640, 480))).all(axis=1) & (dot[:, 2] > 0.2)
        px = px[inside] + NOISE * rng.standard_normal((inside.sum(), 2, 2))
        length = np.linalg.norm(px[:, 1] - px[:, 0], axis=1)
        covariances = NOISE**2 * np.stack([np.full(len(px), 0.5), 2 / np.maximum(length, 1) ** 2], axis=1)
        tracks = blank_tracks(
            *(len(px),),
            frame_index=index,
            ids=np.flatnonzero(inside),
            observed_px=px.astype(np.float32),
            observed_covariances=(covariances[:, :, None] * np.eye(2)).astype(np.float32),
            states=np.full(len(px), TrackState.CONFIRMED, np.uint8),
            point_ids=np.flatnonzero(there),
            points_px=(dot_px[there] + NOISE * rng.standard_normal((there.sum(), 2))).astype(np.float32),
            camera=camera,
        )
        frames.append(tracks)
    return frames


def degrees_off(begun: Begun, poses: Array) -> tuple[float, float]:
    """Of the last frame: of its rotation, and of the direction in which it is."""
    true, found = poses[-1], begun.poses[-1]
    turn = (np.trace(found[:, :3].T @ poses[0, :, :3].T @ true[:, :3]) - 1) / 2
    towards = poses[0, :, :3].T @ (true[:, 3] - poses[0, :, 3])
    along = found[:, 3] @ towards / np.linalg.norm(towards)
    return float(np.rad2deg(np.arccos(min(turn, 1)))), float(np.rad2deg(np.arccos(min(along, 1))))


@pytest.mark.parametrize("points", [0, 60])
@pytest.mark.parametrize("step", [FORWARD, SIDEWAYS, -FORWARD])
def test_begins_on_a_made_world(points: int, step: Array) -> None:
    poses = walk(10, 2 * step, 0.004)
    begun = start(seen_from(poses, points=points))
    assert begun.waits == ""
    assert begun.agreement > 0.9
    assert begun.by in ("points", "corners", "vanishing directions")
    rotation_off, direction_off = degrees_off(begun, poses)
    assert rotation_off < 0.3
    assert direction_off < 3
    assert np.linalg.norm(begun.poses[-1, :, 3]) == pytest.approx(1)
    np.testing.assert_array_equal(begun.poses[0], np.eye(3, 4))
    true = (poses[:, :, 3] - poses[0, :, 3]) @ poses[0, :, :3] / np.linalg.norm(poses[-1, :, 3])
    np.testing.assert_allclose(begun.poses[:, :, 3], true, atol=0.06)


def test_twenty_lines_and_points_are_enough() -> None:
    poses = walk(10, 2 * FORWARD)
    begun = start(seen_from(poses, lines=20, points=60))
    assert begun.waits == ""
    assert degrees_off(begun, poses)[1] < 2


def test_vanishing_directions_alone_tell_the_rotation() -> None:
    """Lines that meet nowhere: parallel to three axes, one of each box."""
    poses = walk(9, 2 * SIDEWAYS, 0.01)
    views = [View.of(frame) for frame in seen_from(poses)[::4]]
    seen = Seen.of(views)
    seen = Seen(seen.views, seen.rays[:, :0], seen.sigmas[:0], 0)
    ((by, motion),) = candidates(seen)
    assert by == "vanishing directions"
    turn = poses[0, :, :3].T @ poses[8, :, :3]
    assert np.trace(motion[1, :, :3].T @ turn) > 1 + 2 * np.cos(np.deg2rad(0.5))


def test_true_poses_leave_residuals_of_one_standard_deviation() -> None:
    poses = walk(9, 2 * SIDEWAYS, 0.01)
    found = []
    for seed in range(10):
        seen = Seen.of([View.of(frame) for frame in seen_from(poses, points=60, seed=seed)[::4]])
        motion = poses[[4, 8]].copy()
        motion = np.concatenate([poses[0, :, :3].T @ motion[:, :, :3], poses[0, :, :3].T @ motion[:, :, 3:]], axis=2)
        lines, points = residuals(seen, motion[None])
        found.append((lines**2).sum(axis=1))
        assert costs(*residuals(seen, motion[None])) < costs(
            *residuals(seen, motion[None] @ np.diag([1, 1, 1, -1.0]) + 0.02)
        )
        depths, sigmas, of_points, own = inverse_depths(seen, np.column_stack([motion[1]]))
        assert (depths > -3 * sigmas).mean() > 0.95
        assert (of_points > -3 * own).mean() > 0.95
        assert np.median(np.abs(points[:, :, : seen.flow])) == pytest.approx(0.67, abs=0.2)
    assert np.mean(np.concatenate(found, axis=1) < 5.99) == pytest.approx(0.95, abs=0.03)


def test_corners_are_where_lines_meet() -> None:
    views = [View.of(frame) for frame in seen_from(walk(3))]
    seen = Seen.of(views)
    found = corners(seen.views)
    assert found.shape[1] > 20
    ends = seen.views[1].ends
    near = np.linalg.norm(found[1, :, None, None] - ends, axis=3).min(axis=(1, 2)) * CAMERA.matrix[0, 0]
    assert near.max() < 6


@pytest.mark.parametrize("points", [0, 60])
def test_a_camera_at_rest_waits(points: int) -> None:
    for count in (5, 12, 30):
        begun = start(seen_from(walk(count, 0 * FORWARD), points=points))
        assert begun.waits
        assert begun.poses.shape == (0, 3, 4)


def test_a_turn_waits_says_so_and_begins_once_the_camera_moves() -> None:
    turning = walk(30, 0 * FORWARD, 0.015)
    moving = turning[-1:] @ np.eye(4) + np.pad(walk(20, 2 * SIDEWAYS)[1:, :, 3:], ((0, 0), (0, 0), (3, 0)))
    poses = np.concatenate([turning, moving])
    frames: list[LineTracks] = []
    waits, dropped = [], 0
    for tracks in seen_from(poses, points=60):
        frames.append(tracks)
        begun = start(frames)
        waits.append(begun.waits)
        if not begun.waits:
            break
        dropped += begun.drop
        del frames[: begun.drop]
    assert len(waits) > 30
    assert all(waits[:30])
    assert sum("only turned so far, by" in why for why in waits[5:30]) > 12
    assert begun.waits == ""
    assert len(begun.poses) == len(frames)
    assert degrees_off(begun, poses[dropped : len(waits)])[1] < 5


def test_frames_that_share_nothing_with_the_last_are_dropped() -> None:
    frames = seen_from(walk(12, 2 * SIDEWAYS), points=60)
    other = [frame.take(frame.ids < 0) for frame in frames[:4]]
    begun = start([*other, *frames[4:]])
    assert begun.waits == "too few lines and points go on"
    assert begun.drop == 4
    assert start(frames[4:]).waits == ""


def test_too_few_lines_wait() -> None:
    begun = start(seen_from(walk(10, 2 * SIDEWAYS), lines=6))
    assert begun.waits == "too few lines and points go on"
    assert begun.drop == 9


def test_no_camera_is_a_sentence() -> None:
    for count in (1, 8):
        with pytest.raises(ConfigError, match="give the source a calibration"):
            start(seen_from(walk(count), camera=None))


def test_no_poselib_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "poselib", None)
    monkeypatch.delitem(sys.modules, "frontend.starting.candidates")
    monkeypatch.delitem(sys.modules, "frontend.start")
    with pytest.raises(ConfigError, match=r"pip install 'airline-frontend\[poses\]'"):
        importlib.import_module("frontend.start")


@cache
def rendered(kind: str) -> tuple[list[LineTracks], Array]:
    """A dozen frames of a clip with points, and their poses."""
    clip = RenderedClip(kind=kind, motion="handheld", seed=204, frames=14)
    frontend = LineFrontend(tracker=LineTracker(TrackerConfig(points=True)))
    frames = [frontend.process(frame).tracks for frame in SceneSource(clip)]
    return frames, np.array([clip.pose(k)[:3] for k in range(14)])


@pytest.mark.parametrize("kind", ["indoor", "street"])
def test_begins_on_a_rendered_clip(kind: str) -> None:
    frames, poses = rendered(kind)
    found = [start(frames[:count]) for count in (3, 10, 14)]
    begun = [one for one in found if not one.waits]
    assert begun
    for one in begun:
        rotation_off, direction_off = degrees_off(one, poses[: len(one.poses)])
        assert rotation_off < 0.2
        assert direction_off < 3

"""Points and lines for PL-VINS, EPLF-VINS and UV-SLAM, as their estimators take them; and vanishing points."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from airline.errors import ConfigError
from frontend import CameraModel, LineTracks
from logs.sinks.open import open_track_sink
from logs.sinks.vanishing import vanishing_points
from logs.tracks.message import encode
from tests.helpers.made_tracks import CAMERA, FISHEYE, made_tracks, result_of, write_all
from tests.helpers.plvins import (
    POINTS_TOPIC,
    TOPIC,
    eplf_pairs,
    has_rosbag,
    landmarks,
    lines_of,
    plvins_pairs,
    points_of,
    read_messages,
    read_rosbag,
    stamp_of,
    uv_lines_of,
    uvslam_runs,
)
from tests.helpers.ros2 import load_node

STEP_NS = 50_000_000
EPOCH_NS = 1_403_636_579_763_555_584
MISSING = (4, 11, 12)  # not read
DARK, JUMP = 8, 16  # a frame without points; one a while behind the frame before, with points of its own


def stream(camera: CameraModel = CAMERA) -> list[LineTracks]:
    """Twenty-four frames with lines that come and go, and points that move evenly until they leave."""
    rng = np.random.default_rng(3)
    start, step = rng.uniform((20, 20), (300, 220), (60, 2)), rng.normal(0, 1.5, (60, 2))
    born, gone = np.arange(60) // 4, np.arange(60) // 4 + rng.integers(1, 14, 60)
    frames = []
    for k in range(24):
        if k in MISSING:
            continue
        ids = np.flatnonzero((born <= k) & (k < gone) & ((born >= JUMP) | (k < JUMP)) & (k != DARK))
        if k >= JUMP:
            ids = np.arange(100, 130)
        seen = np.flatnonzero((np.arange(30) + 3 * k) % 40 < 25)
        stamp_ns = EPOCH_NS + k * STEP_NS + (3 * 10**9 if k >= JUMP else 0)
        tracks = made_tracks(k, stamp_ns, seen, rng, camera=camera)
        pixels = (start[ids % 60] + k * step[ids % 60]).astype(np.float32)
        states = np.ones(len(seen), np.uint8)
        states[::7] = 0
        frames.append(replace(tracks, states=states, point_ids=ids, points_px=pixels))
    return frames


def written(path: Path, frames: list[LineTracks], stride: int = 1):
    write_all(open_track_sink(str(path), points=True, stride=stride), frames)
    return read_messages(path)


def moved(frames: list[LineTracks]) -> dict[int, tuple[LineTracks, dict[int, np.ndarray]]]:
    """By stamp: frames with a point that the frame before had, and x, y, u, v and velocities of each, by its id."""
    found = {}
    for before, now in pairwise(frames):
        assert before.points_normalized is not None
        assert now.points_normalized is not None
        earlier = dict(zip(before.point_ids.tolist(), before.points_normalized.astype(float), strict=True))
        seconds = (now.stamp_ns - before.stamp_ns) / 1e9
        rows = zip(now.point_ids.tolist(), now.points_normalized.astype(float), now.points_px, strict=True)
        points = {k: np.array([*x, *px, *((x - earlier[k]) / seconds)]) for k, x, px in rows if k in earlier}
        points = {k: one for k, one in points.items() if np.isfinite(one).all()}
        if points:
            found[now.stamp_ns] = now, points
    return found


def lines_in(cloud) -> dict[int, tuple[float, ...]]:
    starts = [(point.x, point.y, point.z) for point in cloud.points]
    return lines_of(starts, [list(map(float, channel.values)) for channel in cloud.channels])


def check_points(points: list[dict[int, tuple[float, ...]]], truth: list[dict[int, np.ndarray]]) -> None:
    """The same points, and one landmark for each, with an observation in every message while it lives."""
    for found, expected in zip(points, truth, strict=True):
        np.testing.assert_allclose(list(found.values()), list(expected.values()), rtol=1e-4, atol=1e-5)
    lives = landmarks(points)
    assert len(lives) == len({k for one in truth for k in one}) > 40
    for first, observations in lives:
        for before, now in pairwise(observations):
            assert np.hypot(now[2] - before[2], now[3] - before[3]) < 15, "another point"
        assert first + len(observations) <= len(truth)


@pytest.mark.parametrize("name", ["lines.bag", "run_plvins.mcap", "eplf.bag", "eplf.mcap"])
def test_points_and_lines_of_a_frame_are_a_pair(tmp_path, name):
    frames = stream()
    truth = moved(frames)
    pairs = (eplf_pairs if "eplf" in name else plvins_pairs)(written(tmp_path / name, frames))
    assert [stamp_of(points) for points, _ in pairs] == [stamp_of(lines) for _, lines in pairs] == list(truth)
    check_points([points_of(points) for points, _ in pairs], [points for _, points in truth.values()])
    for (_, lines), (tracks, _) in zip(pairs, truth.values(), strict=True):
        assert tracks.observed_normalized is not None
        chosen = tracks.observed_normalized[tracks.confirmed].reshape(-1, 4)
        np.testing.assert_array_equal(np.array(list(lines_in(lines).values()), np.float32), chosen)
    stamps = [frame.stamp_ns for frame in frames]
    missing = [stamps[0], *(frame.stamp_ns for frame in frames if frame.frame_index in (DARK, DARK + 1, JUMP))]
    assert set(stamps) - set(truth) == set(missing), "the first, those without points, and those whose points are new"


def test_what_has_no_message_is_said(tmp_path, caplog):
    written(tmp_path / "lines.bag", stream())
    assert caplog.messages == [f"{tmp_path}/lines.bag: 3 frames have no message, for want of points"]


@pytest.mark.parametrize("camera", [CAMERA, replace(CAMERA, width=321, height=239)], ids=["even", "odd"])
def test_pl_vins_draws_lines_where_they_are_in_its_undistorted_picture(tmp_path, camera):
    """Its picture node undistorts the image with the optical axis in the middle, width / 2 in whole numbers."""
    frames = stream(camera)[:3]
    middle = camera.width // 2, camera.height // 2
    pairs = plvins_pairs(written(tmp_path / "plvins.bag", frames))
    for (_, lines), tracks in zip(pairs, frames[1:], strict=True):
        found = np.array([channel.values for channel in lines.channels[3:7]]).T.reshape(-1, 2)
        rays = np.insert((found - middle) / (camera.fx, camera.fy), 2, 1.0, axis=1)
        seen = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, camera.coefficients)[0][:, 0]
        np.testing.assert_allclose(seen, tracks.observed_px[tracks.confirmed].reshape(-1, 2), atol=1e-3)


def test_a_dot_is_under_the_line_in_that_picture(tmp_path):
    """The same with pixels alone: a dot drawn in the image, undistorted as the node does, is at channels 3 and 4."""
    (x, y), tracks = (70, 50), stream()[1]
    tracks.observed_px[:, 0] = x, y
    ((_, lines),) = plvins_pairs(written(tmp_path / "plvins.bag", [stream()[0], tracks]))
    matrix = CAMERA.matrix.copy()
    matrix[:2, 2] = 160, 120
    maps = cv2.initUndistortRectifyMap(CAMERA.matrix, CAMERA.coefficients, np.eye(3), matrix, (320, 240), cv2.CV_32FC1)
    image = np.zeros((240, 320), np.float32)
    image[y, x] = 1
    picture = cv2.remap(cv2.GaussianBlur(image, (0, 0), 2), *maps, cv2.INTER_LINEAR)
    rows, columns = np.indices(picture.shape)
    centre = np.array([(columns * picture).sum(), (rows * picture).sum()]) / picture.sum()
    np.testing.assert_allclose([lines.channels[3].values[0], lines.channels[4].values[0]], centre, atol=0.1)


@pytest.mark.parametrize("name", ["uvslam.bag", "run_uvslam.mcap"])
def test_uv_slam_takes_both_out_of_one_message(tmp_path, name):
    frames = stream()
    truth = moved(frames)
    runs = uvslam_runs(written(tmp_path / name, frames))
    used = [cloud for run in runs for cloud in run]
    assert [stamp_of(cloud) for cloud in used] == list(truth)[1:], "all but the first, which it throws away"
    assert [stamp_of(run[0]) > frames[-8].stamp_ns for run in runs] == [False, True], "anew behind the jump"
    check_points([points_of(cloud) for cloud in used], [points for _, points in list(truth.values())[1:]])
    for cloud, (tracks, _) in zip(used, list(truth.values())[1:], strict=True):
        assert len(cloud.channels) == 21
        assert tracks.observed_normalized is not None
        found = np.array(list(uv_lines_of(cloud).values()))
        chosen = tracks.observed_normalized[tracks.confirmed]
        np.testing.assert_array_equal(found[:, :4].astype(np.float32), chosen.reshape(-1, 4))
        straight = replace(CAMERA, distortion="none", coefficients=np.zeros(0)).project(chosen)
        np.testing.assert_allclose(found[:, 4:8], straight.reshape(-1, 4), atol=1e-3)
        assert not found[:, 8:12].any()
        np.testing.assert_array_equal(found[:, 12:].astype(np.float32), vanishing_points(chosen))
    assert len(landmarks(uv_lines_of(cloud) for cloud in used)) > 40


def test_uv_slam_needs_points(tmp_path):
    with pytest.raises(ConfigError, match=r"UV-SLAM .*--points"):
        open_track_sink(str(tmp_path / "uvslam.bag"))
    assert not any(tmp_path.iterdir())


def test_points_that_no_undistortion_reaches_are_left_out_and_come_back_as_others(tmp_path):
    frames = stream(FISHEYE)[:4]
    alive = np.intersect1d(frames[0].point_ids, frames[3].point_ids)
    frames = [replace(one, point_ids=alive, points_px=one.points_px[np.isin(one.point_ids, alive)]) for one in frames]
    frames[1].points_px[0] = 1e5
    assert len(alive) > 1
    pairs = plvins_pairs(written(tmp_path / "plvins.bag", frames))
    assert [len(points_of(points)) for points, _ in pairs] == [len(alive) - 1, len(alive) - 1, len(alive)]
    assert max(points_of(pairs[-1][0])) == len(alive) - 1


@has_rosbag
def test_ros_reads_both_topics(tmp_path):
    frames = stream()
    messages = written(tmp_path / "plvins.bag", frames)
    assert [topic for topic, _ in messages] == [TOPIC, POINTS_TOPIC] * len(moved(frames))
    assert len(read_rosbag(tmp_path / "plvins.bag")) == len(moved(frames))


def test_the_node_publishes_the_same_points_and_lines(tmp_path, monkeypatch, capsys):
    frames = stream()
    node = load_node(monkeypatch)
    clouds, sent = node["PlVinsClouds"](points=True), []
    for tracks in frames:
        data = encode(result_of(tracks), stream=1, sequence=0, name="", sent_ns=0)
        lines, points = clouds.of_frame(node["frame_of"](data))
        sent += [*((TOPIC, one) for one in lines), *((POINTS_TOPIC, one) for one in points)]
    expected = written(tmp_path / "plvins.bag", frames)
    assert [topic for topic, _ in sent] == [topic for topic, _ in expected]
    for (_, found), (_, cloud) in zip(sent, expected, strict=True):
        assert stamp_of(found) == stamp_of(cloud)
        assert [one.name for one in found.channels] == [one.name for one in cloud.channels]
        assert [(p.x, p.y, p.z) for p in found.points] == [(p.x, p.y, p.z) for p in cloud.points]
        for one, other in zip(found.channels, cloud.channels, strict=True):
            np.testing.assert_allclose(one.values, other.values, rtol=1e-6, err_msg=one.name)
    assert capsys.readouterr().err == ""
    clouds = node["PlVinsClouds"](points=True)
    empty = [replace(one, point_ids=one.point_ids[:0], points_px=one.points_px[:0]) for one in frames[:2]]
    for tracks in empty:
        data = encode(result_of(tracks), stream=1, sequence=0, name="", sent_ns=0)
        assert clouds.of_frame(node["frame_of"](data)) == ([], [])
    assert "--points" in capsys.readouterr().err


def directions(rng: np.random.Generator) -> np.ndarray:
    """Three at right angles, and one between two of them."""
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.concatenate([turned, [(turned[0] + turned[1]) / np.sqrt(2)]])


def seen_lines(rng: np.random.Generator, along: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lines in space along these directions, with noise of 0.3 px where f is 460 px; and the direction of each."""
    lines: list[np.ndarray] = []
    whose: list[int] = []
    while len(lines) < count:
        one, middle, half = rng.integers(len(along)), rng.uniform((-4, -3, 3), (4, 3, 10)), rng.uniform(0.25, 1.5)
        ends = middle + half * np.array([[-1], [1]]) * along[one]
        if (ends[:, 2] > 0.5).all():
            ends = ends[:, :2] / ends[:, 2:]
            if (np.abs(ends) < (0.82, 0.52)).all() and np.linalg.norm(ends[1] - ends[0]) > 25 / 460:
                lines.append(ends + rng.normal(0, 0.3 / 460, (2, 2)))
                whose.append(int(one))
    return np.array(lines), np.array(whose)


def scattered(rng: np.random.Generator, count: int) -> np.ndarray:
    """Lines without order."""
    middles, angles = rng.uniform((-0.8, -0.5), (0.8, 0.5), (count, 2)), rng.uniform(0, np.pi, count)
    halves = np.stack([np.cos(angles), np.sin(angles)], 1) * rng.uniform(0.02, 0.16, (count, 1))
    return np.stack([middles - halves, middles + halves], 1)


def test_parallel_lines_get_the_vanishing_point_of_their_direction():
    rng = np.random.default_rng(1)
    shares, errors, chance = [], [], []
    for _ in range(30):
        along = directions(rng)
        lines, whose = seen_lines(rng, along, 60)
        found = vanishing_points(np.concatenate([lines, scattered(rng, 30)]).astype(np.float32)).astype(np.float64)
        has = found[:, 2] == 1
        assert not found[~has].any()
        towards = found / np.linalg.norm(found, axis=1, keepdims=True).clip(1e-9)
        cosines = np.abs((towards[:60] * along[whose]).sum(1)).clip(0, 1)
        errors.extend(np.degrees(np.arccos(cosines))[has[:60]])
        shares.append(has[:60].mean())
        chance.append(has[60:].mean())
    assert np.mean(shares) > 0.9
    assert np.median(errors) < 0.3
    assert (np.array(errors) < 3).mean() > 0.97
    assert np.mean(chance) < 0.12


@pytest.mark.parametrize("count", [0, 1, 5, 20, 100])
def test_lines_without_order_have_hardly_a_vanishing_point(count):
    rng = np.random.default_rng(2)
    found = np.concatenate([vanishing_points(scattered(rng, count).astype(np.float32)) for _ in range(20)])
    assert found.shape == (20 * count, 3)
    assert not len(found) or found[:, 2].mean() < 0.04


def test_lines_that_meet_in_a_corner_are_not_parallel():
    angles = np.linspace(0, np.pi, 8, endpoint=False)
    rays = np.stack([np.cos(angles), np.sin(angles)], 1)
    through = np.stack([-0.1 * rays, 0.2 * rays], 1) + (0.1, 0.05)
    assert not vanishing_points(through.astype(np.float32)).any()

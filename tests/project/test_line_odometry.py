"""The line odometry of the examples: its mathematics on made worlds, its results on the rendered one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from airline.scenes import RenderedClip
from frontend.sources.scene import frame_of
from line_odometry.adjust import adjust, costs
from line_odometry.clips import LSD, OURS, TRUE_LINES, built_in
from line_odometry.geometry import distances, homogeneous, image_lines, move_lines, move_poses, slopes
from line_odometry.odometry import LineOdometry
from line_odometry.pose import pose_from_lines
from line_odometry.score import TrueLines, align, mapped
from line_odometry.triangulation import map_lines, triangulate
from line_odometry.views import View, gather
from tests.helpers.command import ROOT
from tests.helpers.data_sets import write_posed
from tests.helpers.made_tracks import made_tracks
from tests.project.test_examples import example, said

FOCAL = 500.0
KITTI = ROOT.parent / "shared" / "data" / "kitti_clip"


def made_world(seed: int, lines: int = 60, views: int = 6, noise_px: float = 0.0):
    """Segments (N, 2, 3) before a camera that moves sideways, its poses (K, 3, 4), and what it sees of them."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform((-2, -1.5, 3), (2, 1.5, 7), (lines, 3))
    half = rng.normal(size=(lines, 3))
    half *= rng.uniform(0.2, 0.6, (lines, 1)) / np.linalg.norm(half, axis=1, keepdims=True)
    segments = np.stack([middle - half, middle + half], axis=1)
    turns = Rotation.from_rotvec(rng.normal(0, 0.05, (views, 3))).as_matrix()
    centres = np.outer(np.arange(views), (0.2, 0.05, 0.08)) + rng.normal(0, 0.02, (views, 3))
    poses = np.concatenate([turns, centres[:, :, None]], axis=2)
    seen = []
    for pose in poses:
        points = (segments - pose[:, 3]) @ pose[:, :3]
        ends = points[:, :, :2] / points[:, :, 2:] + rng.normal(0, noise_px / FOCAL, (lines, 2, 2))
        seen.append(View(np.arange(lines), homogeneous(ends)))
    return segments, poses, seen


def as_lines(segments):
    along = segments[:, 1] - segments[:, 0]
    return np.stack([segments[:, 0], along / np.linalg.norm(along, axis=1, keepdims=True)], axis=1)


def distance_to(lines, segments):
    """(N, 2) of the end points of segments to lines."""
    away = segments - lines[:, :1]
    return np.linalg.norm(away - (away * lines[:, 1:]).sum(axis=2, keepdims=True) * lines[:, 1:], axis=2)


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_derivatives_are_those_of_the_distances(seed):
    segments, poses, seen = made_world(seed, lines=8, views=2)
    lines, pose, ends = as_lines(segments), np.repeat(poses[1:], 8, axis=0), seen[0].ends
    _, by_pose, by_line = slopes(ends, lines, pose)

    def by_pose_change(change):
        return distances(ends, image_lines(lines, move_poses(pose, change)))

    def by_line_change(change):
        return distances(ends, image_lines(move_lines(lines, change), pose))

    for off, slope in ((by_pose_change, by_pose), (by_line_change, by_line)):
        for k, unit in enumerate(np.eye(slope.shape[2])):
            step = np.tile(1e-6 * unit, (8, 1))
            np.testing.assert_allclose(slope[:, :, k], (off(step) - off(-step)) / 2e-6, atol=1e-6)


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_lines_are_triangulated_where_they_are(seed):
    segments, poses, seen = made_world(seed)
    found = triangulate(gather(seen, FOCAL, least=3), poses)
    known = found.spread < 0.02
    assert known.mean() > 0.5
    assert found.ahead[known].all()
    assert distance_to(found.lines[known], segments[known]).max() < 1e-6
    ends = np.sort(((segments - found.lines[:, :1]) * found.lines[:, 1:]).sum(axis=2), axis=1)
    np.testing.assert_allclose(found.reach[known], ends[known], atol=1e-6)


def test_what_noise_does_to_a_line_is_what_its_spread_says():
    ratios = []
    for seed in range(5):
        segments, poses, seen = made_world(seed, views=12, noise_px=0.3)
        found = triangulate(gather(seen, FOCAL, least=3), poses)
        depth = segments.mean(axis=1)[:, 2]
        known = found.ahead & (found.spread < 0.02)
        ratios.append(distance_to(found.lines, segments).max(axis=1)[known] / (found.spread * depth)[known])
    assert 0.5 < np.median(np.concatenate(ratios)) < 1.5
    assert np.mean(np.concatenate(ratios) < 3) > 0.95


def test_poses_and_lines_come_back_together():
    _, poses, seen = made_world(1)
    observed = gather(seen, FOCAL, least=3)
    rng = np.random.default_rng(0)
    change = np.concatenate([rng.normal(0, 0.005, (6, 3)), rng.normal(0, 0.02, (6, 3))], axis=1)
    free = np.arange(6) >= 2
    change[~free] = 0
    start = move_poses(poses, change)
    first = triangulate(observed, start).lines
    lines, found = adjust(observed, first, start, free, steps=20)
    assert costs(observed, lines, found).sum() < 1e-4 * costs(observed, first, start).sum()
    np.testing.assert_allclose(found, poses, atol=1e-3)
    assert (found[~free] == poses[~free]).all()


def test_a_pose_is_found_among_wrong_lines():
    segments, poses, seen = made_world(2, lines=80, noise_px=0.2)
    ends = seen[4].ends.copy()
    ends[:25] = ends[:25][::-1]  # a third are taken for other lines
    pose = pose_from_lines(ends, as_lines(segments), FOCAL)
    np.testing.assert_allclose(pose, poses[4], atol=0.01)
    assert pose_from_lines(ends[:3], as_lines(segments)[:3], FOCAL) is None


def test_a_line_that_no_view_tells_apart_is_not_known():
    """A line in the plane of the camera's motion: all its planes are one."""
    poses = np.tile(np.eye(3, 4), (6, 1, 1))
    poses[:, 0, 3] = 0.2 * np.arange(6)
    flat = np.array([[[-1.0, 0.5, 4.0], [1.0, 0.5, 4.0]]])
    views = [View(np.array([0]), homogeneous((flat - p[:, 3])[:, :, :2] / 4.0)) for p in poses]
    assert triangulate(gather(views, FOCAL, least=3), poses).spread[0] > 0.2


def views_of_truth(frames: int, motion: str = "handheld") -> tuple[list[View], np.ndarray, float]:
    """Of a rendered clip: what is seen of its true lines, the poses, the focal length."""
    sequence = RenderedClip(seed=5, frames=frames, size=(320, 240), motion=motion)
    views, poses = [], []
    for index, view in enumerate(sequence):
        camera = frame_of(index, view).camera
        views.append(View(view.ids, homogeneous(camera.normalize(view.segments_px))))
        poses.append(view.pose[:3])
    return views, np.array(poses), sequence.K[0, 0]


def run(views: list[View], focal: float) -> LineOdometry:
    odometry = LineOdometry(focal)
    for view in views:
        odometry.add(view)
    return odometry


def test_true_lines_give_the_true_path_and_a_view_without_lines_is_bridged():
    views, poses, focal = views_of_truth(60)
    odometry = run(views, focal)
    path = align(odometry.trajectory(), poses)
    assert max(path.ate_percent, path.rotation_deg) < 0.01
    assert odometry.lost == []
    views[50] = View(np.zeros(0, np.int64), np.zeros((0, 2, 3)))
    odometry = run(views, focal)
    assert odometry.lost == [50]
    assert align(odometry.trajectory(), poses).ate_percent < 0.5


def test_a_camera_at_rest_has_no_path():
    views, _, focal = views_of_truth(12, motion="static")
    assert run(views, focal).trajectory().shape == (0, 3, 4)


def test_our_lines_give_path_and_map():
    seen = built_in(60, [OURS, TRUE_LINES])
    path = align(run(seen.views[OURS], seen.focal).trajectory(), seen.poses)
    assert max(path.ate_percent, path.rotation_deg) < 1
    length, precision = mapped(map_lines(seen.views[OURS], seen.poses, seen.focal)[1], seen.lines)
    best, _ = mapped(map_lines(seen.views[TRUE_LINES], seen.poses, seen.focal)[1], seen.lines)
    assert best > length > 40
    assert precision > 80


def test_a_camera_is_needed():
    tracks = made_tracks(0, 0, np.arange(3), np.random.default_rng(0), camera=None)
    with pytest.raises(ValueError, match="calibration"):
        View.of(tracks)


def test_shares_of_a_map():
    true = np.array([[[0, 0, 4], [2, 0, 4]], [[0, 1, 4], [2, 1, 4]]], float)
    half = np.array([[[0, 0.05, 4], [1, 0.05, 4]]])
    across = np.array([[[1, -0.03, 4], [1, 0.03, 4]]])
    world = TrueLines(true, true, depth=4.0)
    assert mapped(true, world) == pytest.approx((100, 100))
    assert mapped(half, world) == pytest.approx((25, 100), abs=3)
    assert mapped(half, world, tolerance=0.01) == (0, 0)
    assert mapped(across, world) == mapped(np.zeros((0, 2, 3)), world) == (0, 0)


def figures_of(folder: Path, *arguments: object) -> tuple[dict[str, dict[str, float | None]], str]:
    """What the example writes, and what it prints."""
    printed = said("10_line_odometry", folder, *arguments, "--json", "figures.json")
    return json.loads((folder / "figures.json").read_text()), printed


def test_the_command_writes_what_it_prints(tmp_path):
    figures, printed = figures_of(tmp_path, "--frames", "60", "--baselines")
    assert figures.keys() == {OURS, LSD, TRUE_LINES}
    for row in figures.values():
        assert {"ate_percent", "rotation_deg", "mapped_length_percent", "mapped_precision_percent"} <= row.keys()
        error = row["ate_percent"]
        assert error is None or f"{error:.3f}".rstrip("0").rstrip(".") in printed
    assert figures[TRUE_LINES]["ate_percent"] < figures[OURS]["ate_percent"] < 1


def test_a_clip_with_too_little_motion_has_a_map_but_no_path(tmp_path):
    write_posed(tmp_path / "clip")
    ours = figures_of(tmp_path, "--clip", "clip")[0][OURS]
    assert ours["ate_percent"] is None
    assert ours["lost_frames"] > 0


@pytest.mark.skipif(not KITTI.is_dir(), reason="needs the data set kitti_clip")
def test_a_drive_on_a_street(tmp_path):
    assert figures_of(tmp_path, "--clip", KITTI)[0][OURS]["ate_percent"] < 2


def test_a_folder_that_is_no_clip_is_one_line(tmp_path):
    done = example("10_line_odometry", tmp_path, "--clip", "nowhere")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1

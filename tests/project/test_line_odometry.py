"""The line odometry of the examples: its mathematics on made worlds, its results on the rendered one."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from airline.scenes import RenderedClip
from frontend import CameraModel, LineTracks
from line_odometry.clips import LSD, OURS, TRUE_LINES, Seen, rendered
from line_odometry.images import line_errors
from line_odometry.odometry import LineOdometry
from line_odometry.pose import errors_at, pose_from_map
from line_odometry.residual import factor, line_marks
from line_odometry.score import TrueLines, align, mapped
from line_odometry.smoother import Smoother
from line_odometry.triangulation import _slopes, triangulate, triangulate_points
from line_odometry.views import Lines, Points, View, both_cameras, gather, take
from tests.helpers.command import ROOT
from tests.helpers.data_sets import write_posed
from tests.helpers.made_tracks import blank_tracks, made_tracks
from tests.project.test_examples import example, said

FOCAL = 500.0
KITTI = ROOT.parent / "shared" / "data" / "kitti_clip"
SOME = settings(max_examples=25)


def seen_as(ids, ends, noise_px=0.3):
    """Lines with these end points (N, 2, 2), whose ends are off by so many pixels."""
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
    lines = np.column_stack([normal, -(normal * ends.mean(axis=1)).sum(axis=1)])
    sigma = noise_px / FOCAL
    return Lines(ids, ends, lines, np.stack([np.full(len(ids), sigma**2 / 2), 2 * sigma**2 / length**2], axis=1))


def project(points, pose):
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    return local[..., :2] / local[..., 2:]


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
    noise = [rng.normal(0, noise_px / FOCAL, (lines, 2, 2)) for _ in poses]
    seen = [project(segments, pose) + off for pose, off in zip(poses, noise, strict=True)]
    return segments, poses, [seen_as(np.arange(lines), ends, noise_px or 0.3) for ends in seen]


def distance_to(ends, segments):
    """(N, 2) of the end points of segments to the lines through others."""
    along = ends[:, 1:] - ends[:, :1]
    along = along / np.linalg.norm(along, axis=2, keepdims=True)
    away = segments - ends[:, :1]
    return np.linalg.norm(away - (away * along).sum(axis=2, keepdims=True) * along, axis=2)


def numeric(function, count, step=1e-6):
    """Derivatives of a function of so many numbers, at zero."""
    return np.stack([(function(step * unit) - function(-step * unit)) / (2 * step) for unit in np.eye(count)], axis=-1)


@SOME
@given(seed=st.integers(0, 10_000))
def test_derivatives_are_those_of_the_errors(seed):
    segments, poses, seen = made_world(seed, lines=8, views=2)
    other, points = seen[1], Points(np.arange(8), seen[0].ends[:, 1])
    pose = np.vstack([poses[0], (0, 0, 0, 1)])

    def moved(change):
        return pose @ gtsam.Pose3(gtsam.Rot3.Expmap(change[:3]), change[3:]).matrix()

    def by_pose(change):
        return errors_at(moved(change), other, segments, points, segments[:, 0])[0]

    _, slopes = errors_at(pose, other, segments, points, segments[:, 0])
    np.testing.assert_allclose(slopes, numeric(by_pose, 6), atol=1e-3 * np.abs(slopes).max())

    both = gather([seen[0], other], 2)
    _, slopes, across = _slopes(both, segments, poses[both.view])

    def by_line(change):
        pair = (segments + change.reshape(2, 2) @ across)[both.row]
        local = np.einsum("mki,mij->mkj", pair - poses[both.view][:, None, :, 3], poses[both.view][:, :, :3])
        return line_errors(both.seen, local[:, 0], local[:, 1])[0]

    np.testing.assert_allclose(slopes, numeric(by_line, 4), atol=1e-3 * np.abs(slopes).max())


@SOME
@given(seed=st.integers(0, 10_000))
def test_factors_say_how_far_a_point_is_from_the_observed_line(seed):
    """Their errors are the distance across in standard deviations, from the right camera as from the left one."""
    segments, poses, _ = made_world(seed, lines=5, views=2)
    cameras = both_cameras(poses, 0.3)
    seen = [seen_as(np.arange(5), project(segments, camera)) for camera in cameras]
    marks = line_marks(gather(seen, 4), segments, cameras)
    for k in range(len(marks.row)):
        place = marks.places[marks.row[k]] + (0.02, -0.03, 0.01)
        frame, right = divmod(marks.view[k], 2)
        pose = gtsam.Pose3(np.vstack([poses[frame], (0, 0, 0, 1)]))
        one = factor(marks.measured[k], marks.information[k], 0, 1, gtsam.Pose3(gtsam.Rot3(), (0.3 * right, 0, 0)))
        values = gtsam.Values()
        values.insert(0, pose)
        values.insert(1, place)
        line = seen[marks.view[k]]
        at = marks.ids[marks.row[k]] // 2
        image, ends = project(place, cameras[marks.view[k]]), line.ends[at]
        beside = np.linalg.norm(marks.measured[k] - ends.mean(axis=0))
        sigma = np.sqrt(line.variances[at, 0] + beside**2 * line.variances[at, 1])
        off = line.lines[at] @ (*image, 1.0) / sigma
        size = abs(off)
        assert one.error(values) == pytest.approx(0.5 * off**2 if size < 1.345 else 1.345 * (size - 0.6725), 0.01, 1e-5)

        def by_pose_and_place(change, one=one, pose=pose, place=place):
            moved = gtsam.Values()
            moved.insert(0, pose.retract(change[:6]))
            moved.insert(1, place + change[6:])
            return one.error(moved)

        jacobian, left = one.linearize(values).jacobian()
        np.testing.assert_allclose(-left @ jacobian, numeric(by_pose_and_place, 9), atol=1e-3 * np.abs(jacobian).max())


@SOME
@given(seed=st.integers(0, 10_000))
def test_lines_are_triangulated_where_they_are(seed):
    segments, poses, seen = made_world(seed)
    found = triangulate(gather(seen, least=3), poses)
    known = found.spread < 0.02
    assert known.mean() > 0.5
    assert found.ahead[known].all()
    assert distance_to(found.ends[known], segments[known]).max() < 1e-5
    lengths = np.linalg.norm(found.ends[known, 1] - found.ends[known, 0], axis=1)
    np.testing.assert_allclose(lengths, np.linalg.norm(segments[known, 1] - segments[known, 0], axis=1), atol=1e-5)


def test_points_are_triangulated_where_they_are():
    segments, poses, _ = made_world(3)
    seen = [Points(np.arange(60), project(segments[:, 0], pose)) for pose in poses]
    found = triangulate_points(gather(seen, least=3), poses)
    np.testing.assert_allclose(found.ends[:, 0], segments[:, 0], atol=1e-4)
    assert found.ahead.all()


def test_what_noise_does_to_a_line_is_what_its_spread_says():
    ratios = []
    for seed in range(5):
        segments, poses, seen = made_world(seed, views=12, noise_px=0.3)
        found = triangulate(gather(seen, least=3), poses)
        depth = segments.mean(axis=1)[:, 2]
        known = found.ahead & (found.spread < 0.02)
        ratios.append(distance_to(found.ends, segments).max(axis=1)[known] / (found.spread * depth)[known])
    assert 0.5 < np.median(np.concatenate(ratios)) < 1.5
    assert np.mean(np.concatenate(ratios) < 3) > 0.95


def test_poses_come_back_in_the_graph():
    _, poses, seen = made_world(1)
    observed = gather(seen, least=3)
    rng = np.random.default_rng(0)
    start = poses.copy()
    start[1:-1, :, 3] += rng.normal(0, 0.02, (4, 3))
    start[1:, :, :3] = start[1:, :, :3] @ Rotation.from_rotvec(rng.normal(0, 0.005, (5, 3))).as_matrix()
    places = triangulate(observed, start)
    good = places.spread < 0.03
    found = Smoother(start, 0).update(0, start, [line_marks(observed.only(good), places.ends[good], start)])
    assert np.abs(found - poses).max() < 0.25 * np.abs(start - poses).max()
    np.testing.assert_allclose(found[0], poses[0], atol=1e-3)


def test_a_pose_is_found_among_wrong_lines():
    segments, poses, seen = made_world(2, lines=80, noise_px=0.2)
    ends = seen[4].ends.copy()
    ends[:25] = ends[:25][::-1]  # a third are taken for other lines
    lines, none = seen_as(seen[4].ids, ends, 0.2), (Points(np.zeros(0, np.int64), np.zeros((0, 2))), np.zeros((0, 3)))
    pose = pose_from_map(lines, segments, *none, FOCAL, np.eye(4))
    np.testing.assert_allclose(pose[:3], poses[4], atol=0.01)
    assert pose_from_map(take(lines, np.arange(3)), segments[:3], *none, FOCAL, np.eye(4)) is None
    few, points = np.arange(30, 33), Points(np.arange(20), project(segments[:20, 0], poses[4]))
    pose = pose_from_map(take(lines, few), segments[few], points, segments[:20, 0], FOCAL, np.eye(4))
    np.testing.assert_allclose(pose[:3], poses[4], atol=0.01)


def test_a_line_that_no_view_tells_apart_is_not_known():
    """A line in the plane of the camera's motion: all its planes are one."""
    poses = np.tile(np.eye(3, 4), (6, 1, 1))
    poses[:, 0, 3] = 0.2 * np.arange(6)
    flat = np.array([[[-1.0, 0.5, 4.0], [1.0, 0.5, 4.0]]])
    views = [seen_as(np.array([0]), project(flat, pose)) for pose in poses]
    assert triangulate(gather(views, least=3), poses).spread[0] > 0.2


@cache
def truth(motion: str = "handheld") -> Seen:
    """Of a rendered clip: its true lines as tracks, with flow points."""
    return rendered(RenderedClip(seed=5, frames=70, size=(320, 240), motion=motion), [TRUE_LINES])


def tracks_of_truth(frames: int, motion: str = "handheld") -> tuple[list[LineTracks], np.ndarray, float]:
    """The first frames of it, their poses, the focal length."""
    seen = truth(motion)
    return seen.tracks[TRUE_LINES][:frames], seen.poses[:frames], seen.focal


def run(tracks: list[LineTracks], focal: float, points: bool = False) -> LineOdometry:
    odometry = LineOdometry(focal, points=points)
    for one in tracks:
        odometry.add(one)
    return odometry


def without_anything(tracks: LineTracks) -> LineTracks:
    nothing = np.zeros(0, np.int64), np.zeros((0, 2), np.float32)
    return replace(tracks.take(np.zeros(0, np.intp)), point_ids=nothing[0], points_px=nothing[1])


def test_true_lines_give_the_true_path_and_lost_poses_are_regained():
    tracks, poses, focal = tracks_of_truth(70)
    odometry = run(tracks, focal)
    path = align(odometry.trajectory(), poses[odometry.first :])
    assert max(path.ate_percent, path.rotation_deg) < 0.2
    assert (odometry.lost, odometry.failed, len(odometry.begun)) == ([], [], 1)
    for k in (50, 51, 52):
        tracks[k] = without_anything(tracks[k])
    odometry = run(tracks, focal)
    assert [index + odometry.first for index in odometry.lost] == [50, 51, 52]
    assert align(odometry.trajectory(), poses[odometry.first :]).ate_percent < 1


def test_another_map_begins_where_nothing_is_known_any_more():
    tracks, poses, focal = tracks_of_truth(70)
    later = 1 + max(int(one.ids.max()) for one in tracks), 1 + max(int(one.point_ids.max()) for one in tracks)
    for k in range(35, 70):  # as behind a reset of the tracker: all ids are new
        tracks[k] = replace(tracks[k], ids=tracks[k].ids + later[0], point_ids=tracks[k].point_ids + later[1])
    odometry = run(tracks, focal)
    assert len(odometry.begun) == 2
    assert odometry.begun[1] >= 35
    second = odometry.trajectory()[odometry.begun[1] - odometry.first :]
    assert align(second, poses[odometry.begun[1] :]).ate_percent < 0.5  # by itself: its scale is another


PAIR = CameraModel(640, 480, FOCAL, FOCAL, 320, 240, baseline_m=0.12, disparity_offset=3.0)


def made_pairs(frames: int, noise_px: float = 0.0) -> tuple[list[LineTracks], np.ndarray, np.ndarray]:
    """What a pair of cameras sees of segments (N, 2, 3) from the poses (K, 3, 4)."""
    segments, poses, _ = made_world(7, lines=120, views=frames)
    rng, shift = np.random.default_rng(7), np.array([[PAIR.cx, PAIR.cy], [PAIR.cx - PAIR.disparity_offset, PAIR.cy]])
    tracks = []
    for index, cameras in enumerate(both_cameras(poses, PAIR.baseline_m).reshape(frames, 2, 3, 4)):
        ends = FOCAL * np.stack([project(segments, camera) for camera in cameras]) + shift[:, None, None]
        left, right = np.float32(ends + rng.normal(0, noise_px, ends.shape))
        sizes = np.linalg.norm(left[:, 1] - left[:, 0], axis=1)
        errors = np.zeros((len(left), 2, 2), np.float32)
        errors[:, 0, 0], errors[:, 1, 1] = 0.2**2 / 2, 2 * (0.2 / sizes) ** 2
        ours = {"segments_px": left, "observed_px": left, "observed_covariances": errors, "covariances": errors}
        partners = {"right_px": right, "right_covariances": errors, "right_measured": np.zeros(len(left), np.bool_)}
        partners["right_hits"] = np.full(len(left), index + 1, np.int32)
        tracks.append(blank_tracks(len(left), frame_index=index, camera=PAIR, **ours, **partners))
    return tracks, poses, segments


def test_a_pair_is_two_views_whose_lines_are_in_metres():
    (tracks,), poses, segments = made_pairs(1)
    tracks.right_hits[:10], tracks.right_px[:10] = 0, np.nan
    left, right = View.pair_of(tracks)
    assert (len(left.lines.ids), right.lines.ids.tolist()) == (120, list(range(10, 120)))
    found = triangulate(gather([left.lines, right.lines], 2), both_cameras(np.eye(3, 4)[None], PAIR.baseline_m))
    known = found.spread < 0.03
    assert known.sum() > 40
    true = (segments - poses[0][:, 3]) @ poses[0][:, :3]
    assert distance_to(found.ends, true[10:]).max(axis=1)[known].max() < 1e-3
    along = np.abs(tracks.observed_px[10:, 1] - tracks.observed_px[10:, 0])
    assert not known[along[:, 1] < 0.01 * along[:, 0]].any()  # along the rows: no depth


def test_the_path_of_a_pair_begins_at_once_and_is_in_metres():
    tracks, poses, _ = made_pairs(20, noise_px=0.2)
    one_camera = [replace(one, camera=replace(PAIR, baseline_m=0.0)) for one in tracks]
    assert run(one_camera[:1], FOCAL).trajectory().shape == (0, 3, 4)
    odometry = run(tracks[:1], FOCAL)
    np.testing.assert_allclose(odometry.trajectory(), np.eye(3, 4)[None], atol=1e-9)
    odometry = run(tracks, FOCAL)
    assert (odometry.first, odometry.begun, odometry.lost, odometry.failed) == (0, [0], [], [])
    assert align(odometry.trajectory(), poses, metres=True).ate_percent < 0.3
    assert align(odometry.trajectory(), poses * (1, 1, 1, 1.1), metres=True).ate_percent > 1

    for k in range(10, 20):  # as behind a reset of the tracker
        tracks[k] = replace(tracks[k], ids=tracks[k].ids + 1000)
    tracks[4] = without_anything(tracks[4])
    odometry = run(tracks, FOCAL)
    assert (odometry.begun, odometry.lost) == ([0, 12], [4, 10, 11])
    assert align(odometry.trajectory()[12:], poses[12:], metres=True).ate_percent < 0.5
    waits = run([replace(one, right_px=np.full_like(one.right_px, np.nan)) for one in tracks[:3]], FOCAL)
    assert "depth" in waits.waits


def test_a_graph_that_cannot_be_solved_begins_anew(monkeypatch):
    tracks, poses, focal = tracks_of_truth(60)
    update, calls = Smoother.update, []

    def failing(self, *arguments):
        calls.append(1)
        if len(calls) == 4:
            raise RuntimeError("Indeterminate linear system")
        return update(self, *arguments)

    monkeypatch.setattr(Smoother, "update", failing)
    odometry = run(tracks, focal)
    assert len(odometry.failed) == 1
    assert align(odometry.trajectory(), poses[odometry.first :]).ate_percent < 0.2


def test_a_camera_at_rest_has_no_path():
    tracks, _, focal = tracks_of_truth(12, motion="static")
    odometry = run(tracks, focal)
    assert odometry.trajectory().shape == (0, 3, 4)
    assert "not moved" in odometry.waits


def test_our_lines_of_a_rendered_pair_give_metres():
    clip = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=12, size=(320, 240))
    seen = rendered(clip, [OURS, TRUE_LINES], stereo=True)
    odometry = run(seen.tracks[OURS], seen.focal)
    assert (odometry.first, odometry.lost) == (0, [])
    assert align(odometry.trajectory(), seen.poses, metres=True).ate_percent < 1
    assert not run(seen.tracks[TRUE_LINES], seen.focal).baseline_m


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


def test_our_lines_give_path_and_map_and_the_command_writes_what_it_prints(tmp_path):
    figures, printed = figures_of(tmp_path, "--frames", "60", "--baselines")
    assert figures.keys() == {OURS, LSD, TRUE_LINES}
    for row in figures.values():
        assert {"ate_percent", "rotation_deg", "mapped_length_percent", "mapped_precision_percent"} <= row.keys()
        error = row["ate_percent"]
        assert error is None or f"{error:.3f}".rstrip("0").rstrip(".") in printed
    ours, best = figures[OURS], figures[TRUE_LINES]
    assert best["ate_percent"] < ours["ate_percent"] < 0.5
    assert ours["rotation_deg"] < 0.5
    assert best["mapped_length_percent"] > ours["mapped_length_percent"] > 40
    assert ours["mapped_precision_percent"] > 75


def test_a_clip_with_too_little_motion_has_a_map_but_no_path(tmp_path):
    write_posed(tmp_path / "clip")
    ours = figures_of(tmp_path, "--clip", "clip")[0][OURS]
    assert ours["ate_percent"] is None
    assert ours["lost_frames"] > 0


@pytest.mark.skipif(not KITTI.is_dir(), reason="needs the data set kitti_clip")
@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("--slice", "0:26", "--stereo"),
        ("--slice", "50:24:-1"),
        ("--max-lines", "20", "--points"),
    ],
)
def test_a_drive_on_a_street(tmp_path, arguments):
    figures = figures_of(tmp_path, "--clip", KITTI, *arguments)[0][OURS]
    assert figures["ate_percent"] < 0.5
    assert (figures["lost_frames"], figures["maps"]) == (0, 1)


def test_a_folder_that_is_no_clip_is_one_line(tmp_path):
    done = example("10_line_odometry", tmp_path, "--clip", "nowhere")
    assert done.code == 1
    assert len(done.err.splitlines()) == 1

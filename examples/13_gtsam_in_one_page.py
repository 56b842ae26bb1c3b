"""Odometry from lines in one page of GTSAM: `13_gtsam_in_one_page.py [INPUT] [--calib FILE] [--poses FILE] ...`.

A line is two points in space: in every image both lie on the line that was observed, as sure as its covariance says,
and anywhere along it. evo scores the path by --poses, of KITTI or TUM with a row per frame; the built-in clip has some.
"""

import argparse

import gtsam
import numpy as np
from gtsam.noiseModel import Gaussian, Isotropic, Robust, mEstimator
from gtsam.symbol_shorthand import A, B, X
from poselib import estimate_absolute_pose_pnpl

from airline import AirLineError
from frontend import LineFrontend, LineTracker, TrackerConfig, TrackHistory
from frontend.cli.settings import InputConfig, RunConfig
from frontend.cli.wiring import open_input
from frontend.sources.scene import CLIP
from frontend.start import start
from viz.rerun_sink import RerunSink

EVERY, WINDOW, HELD = 4, 16, 8  # frames between keyframes; keyframes in an adjustment; the oldest, which hold the rest
PLANE, HUBER = gtsam.Cal3_S2(1, 1, 0, 0, 0), mEstimator.Huber.Create(1.345)  # images are on the plane z = 1, no lens
CAMERA = {"model": "PINHOLE", "width": 1, "height": 1, "params": [1.0, 1.0, 0.0, 0.0]}


def adjust(keys):  # moves keyframes, the frames after each, and the lines that they see to where all fits best
    graph, values, held = gtsam.NonlinearFactorGraph(), gtsam.Values(), HELD if len(keys) == WINDOW else 1
    for k, key in enumerate(keys):
        values.insert(X(key), gtsam.Pose3(poses[key]))
        graph.addPriorPose3(X(key), gtsam.Pose3(poses[key]), Isotropic.Sigma(6, 1e-6 if k < held else 1e3))
    for track in history.tracks(at_least=3):
        own = np.isin(track.frame_indices, keys)
        by, ends, normals = track.frame_indices[own], track.observed_normalized[own], track.observed_lines[own]
        if len(by) < 3:
            continue
        at, lengths = np.array([poses[key] for key in by]), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        turns, centres, best = at[:, :3, :3], at[:, :3, 3], lengths.argmax()
        offset, angle = np.einsum("nii->in", track.observed_line_covariances[own])
        rays = np.column_stack([ends[best], np.ones(2)]) @ turns[best].T  # of its ends, in the view where it is longest
        planes = np.einsum("nij,nj->ni", turns, normals) / np.sqrt(offset + angle * lengths**2 / 4)[:, None]
        parallax = (planes * (centres[best] - centres)).sum(axis=1)  # each plane . (ray + inverse depth * shift) is 0
        inverse = -(parallax @ planes @ rays.T) / max(parallax @ parallax, 1e-12)
        if not inverse.min() * np.linalg.norm(parallax) > 20:  # standard deviations of the inverse depth
            continue
        points = centres[best] + rays / inverse[:, None]
        local, n = (points - centres[:, None]) @ turns, normals[:, None, :2]
        ahead, image = local[..., 2] > 0.1 / inverse, local[..., :2] / local[..., 2:]
        place = image - ends.mean(axis=1, keepdims=True)  # from the middle of the observed line
        off, sigma = (place * n).sum(axis=2), np.sqrt(offset[:, None] + angle[:, None] * (place**2).sum(axis=2))
        if np.mean((off / sigma)[ahead] ** 2) > 3**2:  # standard deviations from the observed lines
            continue
        for end, symbol in enumerate((A(track.track_id), B(track.track_id))):
            values.insert(symbol, points[end])
            graph.addPriorPoint3(symbol, points[end], Isotropic.Sigma(3, 1 / inverse[end]))  # vague, for the scale
            for k in np.flatnonzero(ahead[:, end]):
                (a, b), sigmas = n[k, 0], [[sigma[k, end]], [0.05 if k == best else 10]]  # across and along the line
                noise = Robust.Create(HUBER, Gaussian.SqrtInformation(np.array([[a, b], [b, -a]]) / sigmas, False))
                foot = image[k, end] - off[k, end] * n[k, 0]
                graph.add(gtsam.GenericProjectionFactorCal3_S2(foot, noise, X(by[k]), symbol, PLANE))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(3)  # the next keyframe goes on
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
    for key, after in zip(keys, [*keys[1:], keys[-1] + 1], strict=True):
        change = found.atPose3(X(key)).matrix() @ np.linalg.inv(poses[key])
        poses.update({frame: change @ poses[frame] for frame in range(key, after) if frame in poses})
    moved = (n for n in history.ids.tolist() if found.exists(A(n)))
    lines.update({n: np.array([found.atPoint3(A(n)), found.atPoint3(B(n))]) for n in moved})
    history.pop_ended()


parser = argparse.ArgumentParser(description="The camera's path and a map of lines, from tracked lines.")
parser.add_argument("input", nargs="?")
for name, kind in {"--calib": str, "--poses": str, "--max-frames": int, "--save": str}.items():
    parser.add_argument(name, type=kind)
options = parser.parse_args()
if options.input is None:
    options.poses, options.max_frames = CLIP.with_name("poses.txt"), options.max_frames or 60
history, poses, lines, keys, last, waiting, count = TrackHistory(), {}, {}, [], [], [], 0
try:
    source = open_input(options.input, RunConfig(input=InputConfig(calib=options.calib, max_frames=options.max_frames)))
    sink = RerunSink(save=options.save or "odometry.rrd")
    for result in LineFrontend(tracker=LineTracker(TrackerConfig(points=True, max_lines=200))).results(source):
        tracks, now, count = result.tracks, result.tracks.frame_index, count + 1
        history.add(tracks)
        sink.write(result)
        if not poses:
            begun = start(waiting := [*waiting, tracks])
            del waiting[: begun.drop]
            print(f"frame {now}: {begun.waits or f'begins by {begun.by}, {begun.agreement:.0%} of the lines agree'}")
            poses = {t.frame_index: np.vstack([p, (0, 0, 0, 1)]) for t, p in zip(waiting, begun.poses, strict=False)}
            keys = [*poses][: -1 : 1 + len(poses) // 8]
        else:
            known, pixel = np.isin(tracks.ids, list(lines)), 1 / tracks.camera.matrix[0, 0]
            points = np.array([lines[line] for line in tracks.ids[known].tolist()]).reshape(-1, 2, 3).swapaxes(0, 1)
            seen = np.zeros((0, 2)), np.zeros((0, 3)), *tracks.observed_normalized[known].swapaxes(0, 1), *points
            ransac, loss = {"max_reproj_error": 2 * pixel, "max_iterations": 100}, {"loss_type": "HUBER"}
            found, report = estimate_absolute_pose_pnpl(*seen, CAMERA, ransac, loss | {"loss_scale": pixel / 2})
            poses |= {now: np.linalg.inv(np.vstack([found.Rt, (0, 0, 0, 1)]))} if report["num_inliers"] > 5 else {}
        if now in poses and (now - keys[-1] >= EVERY or np.isin(tracks.ids, last, invert=True).mean() > 0.3):
            keys, last = [*keys, now], tracks.ids
            adjust(keys[-WINDOW:])
            print(f"frame {now}: keyframe {len(keys)}, {len(lines)} lines in the map")
            sink.log_pose(poses[now])
            sink.log_lines_3d(np.array(list(lines.values())).reshape(-1, 2, 3), np.array(list(lines), int))
    sink.close()
    print(f"{count} frames, {len(poses)} poses, {len(lines)} lines in the map")
    if poses and options.poses:
        from evo.core.geometry import umeyama_alignment

        true, found = np.loadtxt(options.poses)[list(poses)], np.array([pose[:3, 3] for pose in poses.values()])
        true = true[:, 3::4] if true.shape[1] == 12 else true[:, 1:4]
        turn, shift, scale = umeyama_alignment(found.T, true.T, with_scale=True)
        rms = np.sqrt(((scale * found @ turn.T + shift - true) ** 2).sum(axis=1).mean())
        print(f"path error {100 * rms / np.linalg.norm(np.diff(true, axis=0), axis=1).sum():.3f} % of its length")
except AirLineError as error:
    raise SystemExit(f"error: {error}") from None
except ImportError as error:
    print(f"no score: {error}")

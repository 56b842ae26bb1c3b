"""Keyframes and lines in space adjusted by mrob, by the line factor that it brings: `python 14_mrob.py`.

The rest is as in `13_gtsam_in_one_page.py`. Two things mrob 0.0.17 lacks. Under numpy 2, SE3(matrix) ends the process:
poses are made by registering points. And points slide along a line to where it is surest: a vague factor holds them.
"""

import mrob
import numpy as np
from evo.core.geometry import umeyama_alignment
from poselib import estimate_absolute_pose_pnpl

from frontend import LineFrontend, LineTracker, TrackerConfig, TrackHistory
from frontend.sources.scene import CLIP, BuiltInClip
from frontend.sources.wrapped import SelectedFrames
from frontend.start import start

FRAMES, EVERY, WINDOW, FREE, IDEAL = 60, 4, 16, 8, [1.0, 1.0, 0.0, 0.0]
CAMERA, CORNERS = {"model": "PINHOLE", "width": 1, "height": 1, "params": IDEAL}, np.vstack([np.zeros(3), np.eye(3)])


def adjust(keys):  # moves keyframes and the lines that they see to where all fits best
    graph, nodes, ends_of = mrob.FGraph(mrob.HUBER), {}, {}
    for k, key in enumerate(keys):
        pose = mrob.registration.weighted(CORNERS, CORNERS @ poses[key][:3, :3].T + poses[key][:3, 3], np.ones(4))
        mode = mrob.NODE_ANCHOR if k < max(1, len(keys) - FREE) else mrob.NODE_STANDARD
        nodes[key] = graph.add_node_pose_3d(pose, mode)
    for track in history.tracks(at_least=3):
        own = np.isin(track.frame_indices, keys)
        by, ends, normals = track.frame_indices[own], track.observed_normalized[own], track.observed_lines[own]
        if len(by) < 3:
            continue
        at, lengths = np.array([poses[key] for key in by]), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        turns, centres, best = at[:, :3, :3], at[:, :3, 3], lengths.argmax()
        offset, angle = np.einsum("nii->in", np.float64(track.observed_line_covariances[own]))
        variance = offset + angle * lengths**2 / 4  # at the ends
        rays = np.column_stack([ends[best], np.ones(2)])  # of the longest view, whose camera holds the points
        planes = np.einsum("nij,nj->ni", turns, normals) / np.sqrt(variance)[:, None]
        parallax = (planes * (centres[best] - centres)).sum(axis=1)
        inverse = -(parallax @ planes @ turns[best] @ rays.T) / max(parallax @ parallax, 1e-12)
        if not inverse.min() * np.linalg.norm(parallax) > 20:
            continue
        local = rays / inverse[:, None]
        two = ends_of[track.track_id] = [graph.add_node_landmark_3d(p) for p in centres[best] + local @ turns[best].T]
        for node, point, near in zip(two, local, inverse, strict=True):
            graph.add_factor_1pose_1landmark_3d(point, nodes[by[best]], node, near**2 * np.eye(3))
        for k, key in enumerate(by):
            graph.add_factor_camera_proj_3d_line(*np.float64(ends[k]), nodes[key], *two, IDEAL, np.eye(2) / variance[k])
    graph.solve(mrob.LM, 5)
    state = graph.get_estimated_state()
    for key, after in zip(keys, [*keys[1:], keys[-1] + 1], strict=True):
        change = state[nodes[key]] @ np.linalg.inv(poses[key])
        poses.update({frame: change @ poses[frame] for frame in range(key, after) if frame in poses})
    lines.update({line: np.hstack([state[node] for node in two]).T for line, two in ends_of.items()})


history, poses, lines, keys, waiting = TrackHistory(), {}, {}, [], []
source = SelectedFrames(BuiltInClip(), max_frames=FRAMES)
for tracks in LineFrontend(tracker=LineTracker(TrackerConfig(points=True, max_lines=200))).stream(source):
    now = tracks.frame_index
    history.add(tracks)
    if not poses:
        begun = start(waiting := [*waiting, tracks])
        print(f"frame {now}: {begun.waits or f'begins by {begun.by}, {begun.agreement:.0%} of the lines agree'}")
        poses = {k: np.vstack([pose, (0, 0, 0, 1)]) for k, pose in enumerate(begun.poses)}
        keys = list(poses)[:-1]
    else:
        known = np.isin(tracks.ids, list(lines))
        points = np.array([lines[line] for line in tracks.ids[known].tolist()]).swapaxes(0, 1)
        seen = np.zeros((0, 2)), np.zeros((0, 3)), *tracks.observed_normalized[known].swapaxes(0, 1), *points
        ransac = {"max_reproj_error": 2 / tracks.camera.matrix[0, 0], "max_iterations": 100}
        pose = estimate_absolute_pose_pnpl(*seen, CAMERA, ransac, {})[0]
        poses[now] = np.linalg.inv(np.vstack([pose.Rt, (0, 0, 0, 1)]))
    if now in poses and now - keys[-1] >= (EVERY if lines else 1):
        keys.append(now)
        adjust(keys[-WINDOW:])
        print(f"frame {now}: keyframe {len(keys)}, {len(lines)} lines in the map")
true, found = np.loadtxt(CLIP.with_name("poses.txt"))[list(poses), 1:4], np.array([p[:3, 3] for p in poses.values()])
turn, shift, scale = umeyama_alignment(found.T, true.T, with_scale=True)
rms = np.sqrt(((scale * found @ turn.T + shift - true) ** 2).sum(axis=1).mean())
print(f"path error {100 * rms / np.linalg.norm(np.diff(true, axis=0), axis=1).sum():.3f} % of its length")

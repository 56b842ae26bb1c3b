"""Camera poses by RANSAC: from lines of the map (PoseLib's P3L, P2P1L, ...), and of two views from corners of lines."""

from __future__ import annotations

import numpy as np
import poselib
from numpy.typing import NDArray

from line_odometry.geometry import TINY, Array, homogeneous
from line_odometry.views import View

MAX_ERROR = 2.0  # px, of an inlier
LEAST_LINES = 6
CORNER = 6.0  # px between the ends of two lines that meet
LEAST_SINE = 0.35  # between them: the corner of near-parallel lines is anywhere
MAX_EPIPOLAR = 1.0  # px
LEAST_CORNERS = 12
FEW_CORNERS = 24
LEAST_PARALLAX = 3.0  # degrees
PARTS = 8  # of the corners, each of which may tell another pose
PART = 0.7  # of the corners
_IDEAL = {"model": "PINHOLE", "width": 1, "height": 1, "params": [1.0, 1.0, 0.0, 0.0]}  # points on the plane z = 1


def pose_from_lines(ends: Array, lines: Array, focal: float) -> Array | None:
    """(3, 4) the pose from which lines (N, 2, 3) are seen at end points (N, 2, 3); None where they agree on none."""
    if len(lines) < LEAST_LINES:
        return None
    none_2d, none_3d = np.zeros((0, 2)), np.zeros((0, 3))
    pose, report = poselib.estimate_absolute_pose_pnpl(
        none_2d,
        none_3d,
        ends[:, 0, :2],
        ends[:, 1, :2],
        lines[:, 0],
        lines[:, 0] + lines[:, 1],
        _IDEAL,
        {"max_reproj_error": MAX_ERROR / focal, "min_iterations": 30, "max_iterations": 500, "seed": 0},
        {"loss_type": "HUBER", "loss_scale": 0.5 / focal},
    )
    return _world_from_camera(pose) if report["num_inliers"] >= LEAST_LINES else None


def poses_of_second(first: View, second: View, focal: float) -> list[Array]:
    """(3, 4) poses that the second view may have in the first's axes, at distance 1; none where the views do not tell.

    Lines alone say nothing of two views: any two poses explain them. But where lines meet in both views there is, most
    often, a corner in space, and corners are points. The farther apart the two centres the better, yet corners get lost
    on the way: the views tell once half of the corners are seen at angles that differ by `LEAST_PARALLAX`, or when few
    are left. A wrong pose may explain few corners as well as the right one, so others are found from parts of them: the
    lines of the views in between will tell which is right.
    """
    here, there = corners(first, focal), corners(second, focal)
    both = sorted(here.keys() & there.keys())
    points = np.array([[corner[pair] for pair in both] for corner in (here, there)]).reshape(2, -1, 2)
    found = _relative_pose(points, focal, least_parallax=LEAST_PARALLAX if len(both) > FEW_CORNERS else 0.0)
    if found is None:
        return []
    rng = np.random.default_rng(0)
    size = max(LEAST_CORNERS, int(PART * len(both)))
    parts = [points[:, rng.permutation(len(both))[:size]] for _ in range(PARTS)]
    others = [_relative_pose(part, focal) for part in parts]
    return [found, *(pose for pose in others if pose is not None)]


def _relative_pose(points: Array, focal: float, least_parallax: float = 0.0) -> Array | None:
    """The second pose from (2, N, 2) points, None from too few that agree or are seen from too near together."""
    if points.shape[1] < LEAST_CORNERS:
        return None
    options = {"max_epipolar_error": MAX_EPIPOLAR / focal, "min_iterations": 500, "seed": 0}
    pose, report = poselib.estimate_relative_pose(*points, _IDEAL, _IDEAL, options, {})
    found = _world_from_camera(pose)
    rays = [homogeneous(p[report["inliers"]]) for p in points]
    if len(rays[0]) < LEAST_CORNERS:
        return None
    rays = [r / np.linalg.norm(r, axis=1, keepdims=True) for r in (rays[0], rays[1] @ found[:, :3].T)]
    parallax = np.rad2deg(np.median(np.arccos(np.clip((rays[0] * rays[1]).sum(axis=1), -1, 1))))
    if parallax < least_parallax:
        return None
    found[:, 3] /= np.linalg.norm(found[:, 3])
    return found


def corners(view: View, focal: float) -> dict[tuple[int, int], Array]:
    """(2,) where two lines meet with an end of each nearby, by their tracks."""
    flat = view.ends[:, :, :2]
    lines = np.cross(view.ends[:, 0], view.ends[:, 1])
    directions = flat[:, 1] - flat[:, 0]
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), TINY)
    across = directions[:, ::-1] * (-1, 1)
    sines = np.abs(directions @ across.T)
    first, second = np.nonzero(np.triu(sines > LEAST_SINE, 1))
    meeting = np.cross(lines[first], lines[second])
    points = meeting[:, :2] / meeting[:, 2:]
    gaps = [np.linalg.norm(points[:, None] - flat[rows], axis=2).min(axis=1) for rows in (first, second)]
    near = np.flatnonzero(np.maximum(*gaps) * focal < CORNER)
    pairs = zip(view.ids[first[near]].tolist(), view.ids[second[near]].tolist(), strict=True)
    return dict(zip(pairs, points[near], strict=True))


def _world_from_camera(pose: poselib.CameraPose) -> NDArray[np.float64]:
    turn = np.asarray(pose.R).T
    return np.column_stack([turn, -turn @ np.asarray(pose.t)])

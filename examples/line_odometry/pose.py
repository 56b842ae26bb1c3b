"""Camera poses from lines of the map by RANSAC: PoseLib's P3L and kin."""

from __future__ import annotations

import numpy as np
import poselib

from line_odometry.views import Array

MAX_ERROR = 2.0  # px, of an inlier
LEAST_LINES = 6
_IDEAL = {"model": "PINHOLE", "width": 1, "height": 1, "params": [1.0, 1.0, 0.0, 0.0]}  # points on the plane z = 1


def pose_from_lines(ends: Array, points: Array, focal: float) -> Array | None:
    """(3, 4) the pose from which lines are seen; None where they agree on none.

    Args:
        ends: (N, 2, 2) their end points on the plane z = 1.
        points: (N, 2, 3) two points of each in space.
        focal: px.
    """
    if len(points) < LEAST_LINES:
        return None
    pose, report = poselib.estimate_absolute_pose_pnpl(
        np.zeros((0, 2)),
        np.zeros((0, 3)),
        ends[:, 0],
        ends[:, 1],
        points[:, 0],
        points[:, 1],
        _IDEAL,
        {"max_reproj_error": MAX_ERROR / focal, "min_iterations": 30, "max_iterations": 500, "seed": 0},
        {"loss_type": "HUBER", "loss_scale": 0.5 / focal},
    )
    if report["num_inliers"] < LEAST_LINES:
        return None
    turn = np.asarray(pose.R).T
    return np.column_stack([turn, -turn @ np.asarray(pose.t)])

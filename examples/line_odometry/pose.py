"""Camera poses from lines of the map: RANSAC by PoseLib (P3L and kin), and the pose that fits all of them best.

The image of the line through A and B from a pose (R, c) is l = R^T ((A - c) x (B - c)), and an observed point q on the
plane z = 1 is q . l / |(l_0, l_1)| away from it. Sum and difference of these distances at both observed ends are the
offset and the angle of which the frontend tells the variances.
"""

from __future__ import annotations

import cv2
import numpy as np
import poselib

from line_odometry.views import TINY, Array

MAX_ERROR = 2.0  # px, of an inlier
LEAST_LINES = 6
TRUNCATED = 25.0  # squared error, of the comparison of two poses
STEPS, HUBER = 6, 2.0  # of the last adjustment, and standard deviations from which on an error counts linearly there
_IDEAL = {"model": "PINHOLE", "width": 1, "height": 1, "params": [1.0, 1.0, 0.0, 0.0]}  # points on the plane z = 1


def pose_from_lines(ends: Array, variances: Array, points: Array, focal: float, near: Array) -> Array | None:
    """(3, 4) the pose from which lines are seen; None where they agree on none.

    Args:
        ends: (N, 2, 2) their end points on the plane z = 1.
        variances: (N, 2) of their offsets at the middle, and of their angles.
        points: (N, 2, 3) two points of each in space.
        focal: px.
        near: (3, 4) where the camera should be: the answer where the lines agree as well with a pose beside it.
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
    starts = near, np.column_stack([turn, -turn @ np.asarray(pose.t)])
    found = [refined(start, ends, variances, points) for start in starts]
    return min(found, key=lambda one: np.minimum(np.square(line_errors(one, ends, variances, points)[0]).sum(axis=1), TRUNCATED).sum())


def refined(pose: Array, ends: Array, variances: Array, points: Array) -> Array:
    """(3, 4) the pose after Gauss-Newton steps, from about there; arguments as of `pose_from_lines`."""
    for _ in range(STEPS):
        errors, slopes = line_errors(pose, ends, variances, points)
        weight = np.minimum(1, HUBER / np.maximum(np.linalg.norm(errors, axis=1), TINY))[:, None, None]
        hessian = (weight * slopes).reshape(-1, 6).T @ slopes.reshape(-1, 6)
        step = -np.linalg.solve(hessian, (weight * slopes).reshape(-1, 6).T @ errors.ravel())
        turn = pose[:, :3] @ cv2.Rodrigues(step[:3])[0]
        pose = np.column_stack([turn, pose[:, 3] + pose[:, :3] @ step[3:]])
    return pose


def line_errors(pose: Array, ends: Array, variances: Array, points: Array) -> tuple[Array, Array]:
    """(N, 2) whitened errors of offset and angle, and their (N, 2, 6) derivatives.

    These are by a turn of the camera and a shift of its centre, both in its own axes.
    """
    a, b = np.moveaxis((points - pose[:, 3]) @ pose[:, :3], 1, 0)
    images = np.cross(a, b)
    size = np.hypot(images[:, 0], images[:, 1])[:, None]
    first, last = np.moveaxis(np.concatenate([ends, np.ones((len(ends), 2, 1))], axis=2), 1, 0)
    length = np.linalg.norm(last - first, axis=1, keepdims=True)
    probes = np.stack([(first + last) / 2, (last - first) / length], axis=1) / np.sqrt(variances)[:, :, None]
    errors = (probes @ images[:, :, None])[:, :, 0] / size
    by_image = probes / size[:, :, None]
    by_image[:, :, :2] -= errors[:, :, None] * (images[:, None, :2] / size[:, None] ** 2)
    slopes = np.concatenate([np.cross(by_image, images[:, None]), np.cross(by_image, (b - a)[:, None])], axis=2)
    return errors, slopes

"""Camera poses from the map: RANSAC by PoseLib (P3L and kin), and the pose that fits everything best."""

from __future__ import annotations

import cv2
import numpy as np
import poselib

from line_odometry.images import line_errors
from line_odometry.triangulation import POINT_ERROR
from line_odometry.views import TINY, Array, Lines, Points

MAX_ERROR = 2.0  # px, of an inlier
LEAST = 6  # of the inliers
FAR = 25.0  # squared error, of the comparison of two poses
STEPS, HUBER = 6, 2.0  # of the last adjustment, and standard deviations from which on an error counts linearly there
_IDEAL = {"model": "PINHOLE", "width": 1, "height": 1, "params": [1.0, 1.0, 0.0, 0.0]}  # points on the plane z = 1


def pose_from_map(lines: Lines, ends: Array, points: Points, places: Array, focal: float, near: Array) -> Array | None:
    """(4, 4) the pose from which lines and points are seen; None where they agree on none.

    Args:
        lines, points: N and P observed.
        ends: (N, 2, 3) two points of each line in space.
        places: (P, 3) the points there.
        focal: px.
        near: (4, 4) where the camera should be: the answer where all agrees as well with it as with what RANSAC finds.
    """
    if len(ends) + len(places) < LEAST:
        return None
    pose, report = poselib.estimate_absolute_pose_pnpl(
        points.places,
        places,
        lines.ends[:, 0],
        lines.ends[:, 1],
        ends[:, 0],
        ends[:, 1],
        _IDEAL,
        {"max_reproj_error": MAX_ERROR / focal, "min_iterations": 30, "max_iterations": 500, "seed": 0},
        {"loss_type": "HUBER", "loss_scale": 0.5 / focal},
    )
    if report["num_inliers"] < LEAST:
        return None
    turn = np.asarray(pose.R).T
    ransac = np.vstack([np.column_stack([turn, -turn @ np.asarray(pose.t)]), (0, 0, 0, 1)])
    found = [refined(one, lines, ends, points, places) for one in (near, ransac)]
    return min(
        found, key=lambda one: np.minimum((errors_at(one, lines, ends, points, places)[0] ** 2).sum(axis=1), FAR).sum()
    )


def refined(pose: Array, lines: Lines, ends: Array, points: Points, places: Array) -> Array:
    """(4, 4) the pose after Gauss-Newton steps from about there."""
    for _ in range(STEPS):
        errors, slopes = errors_at(pose, lines, ends, points, places)
        weight = np.minimum(1, HUBER / np.maximum(np.linalg.norm(errors, axis=1), TINY))[:, None, None]
        weighted, slopes = (weight * slopes).reshape(-1, 6), slopes.reshape(-1, 6)
        step = -np.linalg.lstsq(weighted.T @ slopes, weighted.T @ errors.ravel(), rcond=None)[0]
        change = np.eye(4)
        change[:3, :3], change[:3, 3] = cv2.Rodrigues(step[:3])[0], step[3:]
        pose = pose @ change
    return pose


def errors_at(pose: Array, lines: Lines, ends: Array, points: Points, places: Array) -> tuple[Array, Array]:
    """(N + P, 2) whitened errors of lines (offset, angle) and of points, and their (N + P, 2, 6) derivatives.

    These are by a turn of the camera and a shift of its centre, both in its own axes.
    """
    a, b = np.moveaxis((ends - pose[:3, 3]) @ pose[:3, :3], 1, 0)
    errors, by_image, images = line_errors(lines, a, b)
    slopes = np.concatenate([np.cross(by_image, images[:, None]), np.cross(by_image, (b - a)[:, None])], axis=2)

    local = (places - pose[:3, 3]) @ pose[:3, :3]
    image, depth = local[:, :2] / local[:, 2:], local[:, 2, None, None]
    by_local = (
        np.concatenate([np.tile(np.eye(2), (len(local), 1, 1)), -image[:, :, None]], axis=2) / depth / POINT_ERROR
    )
    off = (image - points.places) / POINT_ERROR
    off_slopes = np.concatenate([np.cross(by_local, local[:, None]), -by_local], axis=2)
    return np.concatenate([errors, off]), np.concatenate([slopes, off_slopes])

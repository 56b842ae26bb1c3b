"""The residual of a line: its ends as a camera observed them, against the image of the infinite line in space.

A line in space is two points that move across it: A + a E and B + b E, where the rows of E (2, 3) are two directions
across the line as it was first found. So (a, b) are four numbers for its four degrees of freedom. Its image from a
pose (R, c) is

    l = R^T ((A - c) x (B - c)),

the moment of its Pluecker coordinates about the camera (Bartoli and Sturm 2005), and an observed point q on the plane
z = 1 is q . l / |(l_0, l_1)| away from it. The sum and the difference of these distances at both observed ends are the
offset and the angle of which the frontend tells the variances. Such a factor needs no depth to be positive, no point of
the line to be in view, and holds nothing along the line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from line_odometry.views import Array

HUBER = 1.345  # standard deviations from which on an error counts linearly
_LOSS = gtsam.noiseModel.mEstimator.Huber.Create(HUBER)
_NOISE = gtsam.noiseModel.Robust.Create(_LOSS, gtsam.noiseModel.Unit.Create(2))


@dataclass(frozen=True)
class Chart:
    """Where a line was first found.

    Attributes:
        points: (2, 3) A and B.
        across: (2, 3) E, unit vectors.
        turned: (2, 3, 3) the matrices of the cross products with them.
    """

    points: Array
    across: Array
    turned: Array

    @staticmethod
    def at(ends: Array, far: float) -> Chart:
        """The chart of the line through two points (2, 3) that is so far away: its own points are half of that apart."""
        along, *across = np.linalg.svd((ends[1] - ends[0])[None])[2]
        points = ends.mean(axis=0) + far * np.array([[-0.25], [0.25]]) * along
        return Chart(points, np.array(across), np.array([skew(e) for e in across]))

    def line(self, change: Array) -> Array:
        """(2, 3) two points of the line whose coordinates are (4,) `change`."""
        return np.asarray(self.points + change.reshape(2, 2) @ self.across)


def line_factor(pose_key: int, line_key: int, chart: Chart, ends: Array, variances: Array) -> gtsam.NonlinearFactor:
    """The factor between a camera, a Pose3 (world_from_camera), and a line, a vector of four.

    Args:
        pose_key, line_key: of the variables.
        chart: of the line.
        ends: (2, 2) observed, on the plane z = 1.
        variances: (2,) of the observed line's offset at its middle, and of its angle.
    """
    weights = line_weights(ends, variances)

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, change = values.atPose3(pose_key), values.atVector(line_key)
        turn, centre = pose.rotation().matrix(), pose.translation()
        found = line_error(weights, chart, change, turn, centre, jacobians is not None)
        if jacobians is not None:
            jacobians[0], jacobians[1] = found[1:]
        return found[0]

    return gtsam.CustomFactor(_NOISE, [pose_key, line_key], error)


def line_weights(ends: Array, variances: Array) -> Array:
    """(2, 3) what makes the whitened errors of offset and angle of an image line l with |(l_0, l_1)| = 1."""
    first, last = np.column_stack([ends, np.ones(2)])
    length = np.linalg.norm(last - first)
    return np.stack([(first + last) / 2, (last - first) / length]) / np.sqrt(variances)[:, None]


def line_error(
    weights: Array, chart: Chart, change: Array, turn: Array, centre: Array, slopes: bool
) -> tuple[Array, Array, Array]:
    """(2,) whitened error, with its (2, 6) and (2, 4) derivatives by the pose, in GTSAM's chart, and by the line."""
    a, b = chart.line(change) - centre
    image = (skew(a) @ b) @ turn
    size = np.hypot(image[0], image[1]) + 1e-300
    error = weights @ image / size
    if not slopes:
        return error, error, error
    by_image = weights / size
    by_image[:, :2] -= np.outer(error, image[:2] / size**2)
    by_pose = by_image @ np.concatenate([skew(image), skew((b - a) @ turn)], axis=1)
    by_line = by_image @ (turn.T @ np.concatenate([chart.turned @ b, -chart.turned @ a]).T)
    return error, by_pose, by_line


def skew(v: Array) -> Array:
    """(3, 3) the matrix of the cross product with v (3,)."""
    x, y, z = v.tolist()
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))

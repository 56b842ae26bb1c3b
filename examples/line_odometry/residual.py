"""The residual of a line: points of it in space against the infinite line that a camera observed, as GTSAM factors.

Two points stand for a line in space. The image q of such a point may lie anywhere on the observed line, and off it by
that line's offset and angle (see `frontend.camera.lines`). So with the normal n of the observed line, its direction u,
the foot m of q on it, and t the place of m from its middle, the whitened error is

    ( n . (q - m) / sqrt(var_offset + t^2 var_angle),   u . (q - m) / along )

which is GTSAM's projection factor with the measurement m and that square-root information: its Jacobians are GTSAM's.
The second row is for what no observation tells, the place of the point along its line: one view holds it, and in all
others `along` is so large that it says nothing.
"""

from __future__ import annotations

import gtsam
import numpy as np

from line_odometry.views import Array

HELD, FREE = 0.05, 10.0  # standard deviations along the line, on the plane z = 1
import os
HUBER = float(os.environ.get("HUB","1.345"))  # standard deviations from which on an error counts linearly
_PLANE = gtsam.Cal3_S2(1, 1, 0, 0, 0)  # observations are on the plane z = 1
_LOSS = getattr(gtsam.noiseModel.mEstimator,os.environ.get("LOSS","Huber")).Create(HUBER)


def line_factor(
    pose_key: int, point_key: int, image: Array, off: float, sigma: float, line: Array, along: float
) -> gtsam.NonlinearFactor:
    """The factor between a camera, a Pose3 (world_from_camera), and a point of a line, a Point3.

    Args:
        pose_key, point_key: of the variables.
        image: (2,) where the point is seen about, on the plane z = 1.
        off: distance of that from the observed line, with its standard deviation `sigma`.
        line: (3,) coefficients of the observed line.
        along: `HELD` or `FREE`.
    """
    normal, direction = line[:2], np.array([line[1], -line[0]])
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(np.stack([normal / sigma, direction / along]))
    noise = gtsam.noiseModel.Robust.Create(_LOSS, noise)
    return gtsam.GenericProjectionFactorCal3_S2(image - off * normal, noise, pose_key, point_key, _PLANE, False, False)

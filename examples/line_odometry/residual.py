"""The residuals: points of a line in space against the infinite line that a camera observed, and points against points.

Two points stand for a line in space. The image q of such a point may lie anywhere on the observed line, and off it by
that line's offset and angle (see `frontend.camera.lines`). So with the normal n of the observed line, its direction u,
the foot m of q on it, and t the place of m from its middle, the whitened error is

    ( n . (q - m) / sqrt(var_offset + t^2 var_angle),   u . (q - m) / along )

which is GTSAM's projection factor with the measurement m and that square-root information: its Jacobians are GTSAM's.
The second row is for what no observation tells, the place of the point along its line: one view holds it, and in all
others `along` is so large that it says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from line_odometry.triangulation import POINT_ERROR
from line_odometry.views import TINY, Array, Ids, Lines, Observations, Points

HELD, FREE = 0.05, 10.0  # standard deviations along the line, on the plane z = 1
NEAR = 0.1  # depth of a point that counts, in distances from the newest camera
HUBER = 1.345  # standard deviations from which on an error counts linearly
_PLANE = gtsam.Cal3_S2(1, 1, 0, 0, 0)  # observations are on the plane z = 1
_LEFT = gtsam.Pose3()
_LOSS = gtsam.noiseModel.mEstimator.Huber.Create(HUBER)


@dataclass(frozen=True)
class Marks:
    """Points in space, and where cameras saw them.

    Attributes:
        ids: (Q,) of the points.
        places: (Q, 3) where they are about.
        row, view: (M,) of each observation: its point, and the number of its view, ascending for each point.
        measured: (M, 2) on the plane z = 1.
        information, held: (M, 2, 2) square roots of the information, the latter of the view that holds the point.
    """

    ids: Ids
    places: Array
    row: NDArray[np.intp]
    view: NDArray[np.intp]
    measured: Array
    information: Array
    held: Array


def line_marks(seen: Observations[Lines], places: Array, poses: Array) -> Marks:
    """Two marks for each line, of points (N, 2, 3) on it, as observed under poses (K, 3, 4)."""
    off, variances, depth, image = _across(places[seen.row], seen.seen, poses[seen.view])
    normal = seen.seen.lines[:, :2]
    along = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
    far = np.linalg.norm(places - poses[-1][:, 3], axis=2)[seen.row]
    end, k = np.nonzero((depth > NEAR * far).T)
    rows = [np.stack([normal[k] / np.sqrt(variances[k, end])[:, None], along[k] / s], axis=1) for s in (FREE, HELD)]
    measured = image[k, end] - off[k, end, None] * normal[k]
    row = 2 * seen.row[k] + end
    order = np.argsort(row, kind="stable")
    arrays = (values[order] for values in (row, seen.view[k], measured, *rows))
    return Marks(line_ids(seen.ids).ravel(), places.reshape(-1, 3), *arrays)


def line_ids(tracks: Ids) -> Ids:
    """(N, 2) ids of the two marks of lines (N,)."""
    return 2 * tracks[:, None] + np.arange(2)


def point_marks(seen: Observations[Points], places: Array) -> Marks:
    """A mark for each point (N, 3); their ids are negative."""
    information = np.tile(np.eye(2) / POINT_ERROR, (len(seen.row), 1, 1))
    return Marks(-1 - seen.ids, places, seen.row, seen.view, seen.seen.places, information, information)


def factor(
    measured: Array, information: Array, pose_key: int, point_key: int, camera: gtsam.Pose3 = _LEFT
) -> gtsam.NonlinearFactor:
    """The factor between a Pose3 (world_from_camera) and a Point3, for one observation of `Marks`.

    The camera that observed is at `camera` in the axes of the one whose pose it is: the right one of a pair.
    """
    # not its smart way, which takes a diagonal for sigmas and refuses a minus there
    gaussian = gtsam.noiseModel.Gaussian.SqrtInformation(information, False)
    noise = gtsam.noiseModel.Robust.Create(_LOSS, gaussian)
    return gtsam.GenericProjectionFactorCal3_S2(measured, noise, pose_key, point_key, _PLANE, False, False, camera)


def _across(points: Array, seen: Lines, poses: Array) -> tuple[Array, Array, Array, Array]:
    """How far points (M, 2, 3) are from the lines that were observed under poses (M, 3, 4).

    Returns:
        (M, 2) distances on the plane z = 1, their variances there, depths, and (M, 2, 2) images.
    """
    local = np.einsum("mki,mij->mkj", points - poses[:, None, :, 3], poses[:, :, :3])
    depth = local[:, :, 2]
    image = local[:, :, :2] / np.where(np.abs(depth) < TINY, TINY, depth)[:, :, None]
    a, b = seen.lines[:, None, 0], seen.lines[:, None, 1]
    place = image - seen.ends.mean(axis=1)[:, None]
    off = a * place[:, :, 0] + b * place[:, :, 1]
    beside = b * place[:, :, 0] - a * place[:, :, 1]
    return off, seen.variances[:, :1] + beside**2 * seen.variances[:, 1:], depth, image

"""The line in space that fits what a track observed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.errors import from_extra
from airline.kernels.compiled import njit

with from_extra("evaluate"):
    from scipy.optimize import leastsq

ROUNDS = 200  # at most, of Levenberg and Marquardt's method
PRECISE = 1e-8  # relative, of the sum of squares and of the solution
TINY = 1e-9

Array = NDArray[np.float64]


def triangulate(poses: Array, segments: Array, K: Array) -> Array:
    """The line in space that a track's observations agree on.

    It begins as the least-squares intersection of the observations' planes, spanned by the two largest right singular
    vectors of the stacked planes (Hartley and Zisserman 2004, 12.7); where the camera stood still, somewhere in the
    plane of the middle one. Levenberg and Marquardt's method in its four degrees of freedom then reduces the distances
    of the observed end points in the images.

    Args:
        poses: (N, 3, 4) world_from_camera of the observations.
        segments: (N, 2, 2) px.
        K: (3, 3) intrinsic matrix, px.

    Returns:
        (2, 3) a point of the line and its direction, of any length.
    """
    centres = poses[:, :, 3]
    origin = centres.mean(axis=0)
    unit = float(np.linalg.norm(centres - origin, axis=1).max())
    normals = plane_normals(poses, segments, K)
    if unit > TINY:
        offsets = np.einsum("nc,nc->n", normals, origin - centres)
        planes = np.linalg.svd(np.column_stack([normals, offsets / unit]))[2][:2]
        nearest = np.linalg.lstsq(planes[:, :3], -planes[:, 3], rcond=None)[0]
        direction = np.cross(planes[0, :3], planes[1, :3])
    else:
        unit, middle = 1.0, len(poses) // 2
        nearest = poses[middle, :, :3] @ np.linalg.solve(K, [*segments[middle].mean(axis=0), 1])
        direction = np.cross(normals[middle], nearest)
    point, direction = nearest * unit + origin, direction / max(float(np.linalg.norm(direction)), TINY)
    sideways = np.linalg.svd(direction[None])[2][1:]
    change, *_ = leastsq(
        _errors,
        np.zeros(4),
        args=(point, direction, unit, sideways, _to_image(poses, K), np.ascontiguousarray(centres), segments),
        ftol=PRECISE,
        xtol=PRECISE,
        gtol=PRECISE,
        maxfev=ROUNDS,
        full_output=True,  # which does not warn when it stops there
    )
    return np.stack([point + unit * change[:2] @ sideways, direction + change[2:] @ sideways])


def image_lines(poses: Array, line: Array, K: Array) -> Array:
    """(N, 3) images of a line in space: a x + b y + c = 0 with unit normal (a, b), px."""
    lines = np.einsum("nij,nj->ni", _to_image(poses, K), np.cross(line[0] - poses[:, :, 3], line[1]))
    return np.asarray(lines / np.maximum(np.hypot(lines[:, 0], lines[:, 1]), TINY)[:, None])


def distances(segments: Array, lines: Array) -> Array:
    """(N, 2) distances of end points (N, 2, 2) to image lines (N, 3), px."""
    return np.asarray(np.abs(np.einsum("nec,nc->ne", segments, lines[:, :2]) + lines[:, 2:]))


def plane_normals(poses: Array, segments: Array, K: Array) -> Array:
    """(N, 3) unit normals, in the world, of the planes through the camera's centre and the segment."""
    rays = np.pad(segments, ((0, 0), (0, 0), (0, 1)), constant_values=1) @ np.linalg.inv(K).T
    normals = np.einsum("nij,nj->ni", poses[:, :, :3], np.cross(rays[:, 0], rays[:, 1]))
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), TINY))


def _to_image(poses: Array, K: Array) -> Array:
    """(N, 3, 3) what makes the image line of the normal, in the world, of a plane through the camera's centre."""
    return np.ascontiguousarray(np.linalg.inv(K).T @ poses[:, :, :3].transpose(0, 2, 1))


@njit()
def _errors(change, point, direction, unit, sideways, to_image, centres, segments):  # type: ignore[no-untyped-def]
    """(2 N,) signed distances of the end points to the line's image, px."""
    moved = point + unit * (change[0] * sideways[0] + change[1] * sideways[1])
    turned = direction + change[2] * sideways[0] + change[3] * sideways[1]
    errors = np.empty(2 * len(segments))
    for row in range(len(segments)):
        a, b, c = _project(to_image[row], moved - centres[row], turned)
        size = max(np.hypot(a, b), TINY)
        for end in range(2):
            errors[2 * row + end] = (a * segments[row, end, 0] + b * segments[row, end, 1] + c) / size
    return errors


@njit()
def _project(to_image, p, q):  # type: ignore[no-untyped-def]
    """Image, to any scale, of the plane through the camera's centre that p and q span."""
    x, y, z = p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]
    m = to_image
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )

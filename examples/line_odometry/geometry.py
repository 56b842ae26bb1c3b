"""Lines in space, their images, and how both change.

A line is a point on it and its unit direction, (2, 3); a pose is world_from_camera, (3, 4). Image points are on the
plane z = 1. From the camera's centre c a line (p, d) is seen in the plane with the normal (p - c) x d, which is the
moment of its Pluecker coordinates taken about c; in the camera's axes that normal is the line's image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
TINY = 1e-12


def homogeneous(points: NDArray[np.floating]) -> Array:
    """(..., 3) image points with a third coordinate of 1 from (..., 2) ones."""
    return np.concatenate([points, np.ones((*np.shape(points)[:-1], 1))], axis=-1)


def image_lines(lines: Array, poses: Array) -> Array:
    """(M, 3) the images of lines (M, 2, 3) under poses (M, 3, 4)."""
    moments = np.cross(lines[:, 0] - poses[:, :, 3], lines[:, 1])
    return (moments[:, None] @ poses[:, :, :3])[:, 0]


def distances(ends: Array, images: Array) -> Array:
    """(M, 2) signed distances of end points (M, 2, 3) to image lines (M, 3), on the plane z = 1."""
    across = (ends @ images[:, :, None])[:, :, 0]
    return across / np.maximum(np.hypot(images[:, 0], images[:, 1]), TINY)[:, None]


def sideways(directions: Array) -> Array:
    """(N, 2, 3) two unit vectors across each unit direction (N, 3) and each other."""
    least = np.eye(3)[np.abs(directions).argmin(axis=1)]
    first = np.cross(directions, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], axis=1)


def move_lines(lines: Array, change: Array) -> Array:
    """Lines after a change of their four degrees of freedom.

    Args:
        lines: (N, 2, 3).
        change: (N, 4) shift of the point, in the world's unit, and of the direction's tip, both along `sideways`.
    """
    across = sideways(lines[:, 1])
    points = lines[:, 0] + np.einsum("nk,nkc->nc", change[:, :2], across)
    directions = lines[:, 1] + np.einsum("nk,nkc->nc", change[:, 2:], across)
    return np.stack([points, directions / np.linalg.norm(directions, axis=1, keepdims=True)], axis=1)


def move_poses(poses: Array, change: Array) -> Array:
    """Poses (N, 3, 4) after (N, 6) a rotation vector in the camera's axes and a shift of the centre in the world's."""
    turned = poses[:, :, :3] @ Rotation.from_rotvec(change[:, :3]).as_matrix()
    return np.concatenate([turned, (poses[:, :, 3] + change[:, 3:])[:, :, None]], axis=2)


def slopes(ends: Array, lines: Array, poses: Array) -> tuple[Array, Array, Array]:
    """Distances of observed end points to the images of lines, with their derivatives at no change.

    Args:
        ends: (M, 2, 3) observed end points on the plane z = 1.
        lines: (M, 2, 3) the line of each observation.
        poses: (M, 3, 4) the pose of each observation.

    Returns:
        (M, 2) distances, (M, 2, 6) derivatives by the change in `move_poses`, (M, 2, 4) by that in `move_lines`.
    """
    images = image_lines(lines, poses)
    size = np.maximum(np.hypot(images[:, 0], images[:, 1]), TINY)[:, None]
    off = (ends @ images[:, :, None])[:, :, 0] / size
    by_image = ends / size[:, :, None]
    by_image[:, :, :2] -= off[:, :, None] * (images[:, :2] / size**2)[:, None]
    by_moment = by_image @ poses[:, :, :3].transpose(0, 2, 1)
    by_centre = np.cross(by_moment, lines[:, 1:])
    by_tip = np.cross(by_moment, (lines[:, 0] - poses[:, :, 3])[:, None])
    across = sideways(lines[:, 1]).transpose(0, 2, 1)
    by_pose = np.concatenate([np.cross(by_image, images[:, None]), by_centre], axis=2)
    return off, by_pose, np.concatenate([-by_centre @ across, by_tip @ across], axis=2)

"""Lines and points in space from their images under known poses, and how well they are known.

A line in space is two points on it. An observation spans a plane through the camera's centre, and a point of the line
lies in all of them: weighted by how sure the observation is there, that is a linear problem for each point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from line_odometry.views import TINY, Array, Ids, Lines, Observations, Points, gather

ALONG = 1e-4  # weight of a point's place along its line, which no observation tells, over that across
HUBER = 2.0  # standard deviations
STEPS = 4
POINT_ERROR = 5e-4  # of an observed point, on the plane z = 1
PART_VIEWS = 3  # views that a part of a line must have been seen in
MAP_VIEWS, MAP_RMS, MAP_SPREAD = 5, 1.0, 0.004  # of a line in a map: at least, px, and 4 mm of its worse end at a metre


@dataclass(frozen=True)
class Triangulated:
    """Lines, or points, and what can be said of them. Row k of every array is track k.

    Attributes:
        ends: (N, 2, 3) of lines, what at least `PART_VIEWS` views saw of them; (N, 1, 3) points.
        rms: (N,) distance of the observations from their images, on the plane z = 1.
        spread: (N,) standard deviation of the worse end across the line, as share of its distance from the cameras.
        ahead: (N,) whether it lies before all cameras that saw it.
    """

    ends: Array
    rms: Array
    spread: Array
    ahead: NDArray[np.bool_]


def map_lines(views: Sequence[Lines], poses: Array, focal: float) -> tuple[Ids, Array]:
    """Tracks (N,) and end points in space (N, 2, 3) of the lines that views agree on from poses (K, 3, 4)."""
    seen = gather(views, MAP_VIEWS)
    found = triangulate(seen, poses)
    good = found.ahead & (focal * found.rms < MAP_RMS) & (found.spread < MAP_SPREAD)
    return seen.ids[good], found.ends[good]


def triangulate(seen: Observations[Lines], poses: Array) -> Triangulated:
    """Lines that fit what was seen of them in two views or more, under poses (K, 3, 4) world_from_camera."""
    own, counts = poses[seen.view], np.maximum(seen.counts, 1)
    planes = np.einsum("mij,mj->mi", own[:, :, :3], seen.seen.lines)  # (M, 3) normals in the world
    middle = seen.sums(own[:, :, 3]) / counts[:, None]
    ends = _reach(seen, *_meet(seen, planes, own[:, :, 3], middle), own)
    along = ends[:, 1] - ends[:, 0]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), TINY)
    held = along[:, :, None] * along[:, None]
    for _ in range(STEPS):
        off, variances, depth, _ = across(ends[seen.row], seen.seen, own)
        size = np.abs(off) / np.sqrt(variances)
        weight = np.minimum(1, HUBER / np.maximum(size, TINY)) / (variances * depth**2)
        hessian = seen.sums(weight[:, :, None, None] * (planes[:, :, None] * planes[:, None])[:, None])
        total = np.einsum("nkii->nk", hessian)[:, :, None, None]
        hessian += total * (ALONG * held[:, None] + 1e-9 * np.eye(3)) + 1e-30 * np.eye(3)
        gradient = seen.sums((weight * off * depth)[:, :, None] * planes[:, None])
        ends = ends - np.linalg.solve(hessian, gradient[:, :, :, None])[:, :, :, 0]
    off, variances, depth, _ = across(ends[seen.row], seen.seen, own)
    surprise = np.maximum(1, seen.sums((off**2 / variances).mean(axis=1)) / counts)
    sideways = np.einsum("nij,nkji->nk", np.eye(3) - held, np.linalg.inv(hessian))
    spread = np.sqrt(surprise[:, None] * sideways).max(axis=1)
    return _judged(seen, ends, off, spread, depth, middle)


def triangulate_points(seen: Observations[Points], poses: Array) -> Triangulated:
    """Points where the rays of two views or more come nearest to each other, under poses (K, 3, 4)."""
    own = poses[seen.view]
    rays = np.einsum("mij,mj->mi", own[:, :, :2], seen.seen.places) + own[:, :, 2]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    beside = np.eye(3) - rays[:, :, None] * rays[:, None]
    hessian = seen.sums(beside) + 1e-9 * np.eye(3)
    points = np.linalg.solve(hessian, seen.sums(beside @ own[:, :, 3:]))[:, :, 0]
    local = np.einsum("mi,mij->mj", points[seen.row] - own[:, :, 3], own[:, :, :3])
    off = np.linalg.norm(local[:, :2] / local[:, 2:] - seen.seen.places, axis=1, keepdims=True)
    middle = seen.sums(own[:, :, 3]) / np.maximum(seen.counts, 1)[:, None]
    far = np.linalg.norm(points - middle, axis=1)
    spread = POINT_ERROR * far * np.sqrt(np.einsum("nii->n", np.linalg.inv(hessian)))
    return _judged(seen, points[:, None], off, spread, local[:, 2:], middle)


def _judged(
    seen: Observations[Lines] | Observations[Points], ends: Array, off: Array, spread: Array, depth: Array, middle: Array
) -> Triangulated:
    far = np.linalg.norm(ends - middle[:, None], axis=2).max(axis=1)
    rms = np.sqrt(seen.sums((off**2).mean(axis=1)) / np.maximum(seen.counts, 1))
    ahead = np.minimum.reduceat(depth.min(axis=1), seen.starts) > 0 if len(ends) else np.zeros(0, np.bool_)
    return Triangulated(ends, rms, spread / np.maximum(far, TINY), ahead)


def across(points: Array, seen: Lines, poses: Array) -> tuple[Array, Array, Array, Array]:
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


def _meet(seen: Observations[Lines], planes: Array, centres: Array, middle: Array) -> tuple[Array, Array]:
    """(N, 3) points and unit directions of the lines in which planes meet (Hartley and Zisserman 2004, 12.7)."""
    centres = centres - middle[seen.row]
    unit = np.sqrt(seen.sums((centres**2).sum(axis=1)) / np.maximum(seen.counts, 1)) + TINY
    flat = np.column_stack([planes, -(planes * centres).sum(axis=1) / unit[seen.row]])
    flat /= np.linalg.norm(planes, axis=1, keepdims=True)
    two = np.linalg.eigh(seen.sums(flat[:, :, None] * flat[:, None]))[1][:, :, 2:]
    (n, m), (a, b) = np.moveaxis(two[:, :3], 2, 0), np.moveaxis(two[:, 3:], 2, 0)
    directions = np.cross(n, m)
    size = np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), TINY)
    points = np.cross(b * n - a * m, directions) / size**2
    alone = size <= TINY  # planes that coincide tell no line: any will do, it is found wanting later
    return points * unit[:, None] + middle, np.where(alone, (1.0, 0.0, 0.0), directions / size)


def _reach(seen: Observations[Lines], points: Array, directions: Array, poses: Array) -> Array:
    """(N, 2, 3) first and last point of lines that `PART_VIEWS` views saw, where lines come nearest to their rays."""
    rays = np.einsum("mij,mkj->mki", poses[:, :, :2], seen.seen.ends) + poses[:, None, :, 2]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    along, away = directions[seen.row][:, None], (points[seen.row] - poses[:, :, 3])[:, None]
    cosine = (along * rays).sum(axis=2)
    places = (cosine * (rays * away).sum(axis=2) - (along * away).sum(axis=2)) / np.maximum(1 - cosine**2, TINY)
    low, high = np.sort(places, axis=1).T
    reach = np.zeros((len(points), 2))
    for row, (start, count) in enumerate(zip(seen.starts.tolist(), seen.counts.tolist(), strict=True)):
        own, k = slice(start, start + count), min(PART_VIEWS, count) - 1
        reach[row] = np.partition(low[own], k)[k], -np.partition(-high[own], k)[k]
    return points[:, None] + reach[:, :, None] * directions[:, None]

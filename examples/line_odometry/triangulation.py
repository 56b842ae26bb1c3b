"""Lines and points in space from their images under known poses, and how well they are known.

A line is fitted by Gauss-Newton steps on the residual of `images`, all lines at once; two points that move across it
are its four degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from line_odometry.images import end_errors, line_errors
from line_odometry.views import TINY, Array, Ids, Lines, Observations, Points, gather

APART = (
    0.25  # half the distance of the two points that stand for a line while it is fitted, in distances from the cameras
)
HUBER = 2.0  # standard deviations
STEPS = 4
POINT_ERROR = 5e-4  # of an observed point, on the plane z = 1
PART_VIEWS = 3  # views that a part of a line must have been seen in
MAP_VIEWS, MAP_RMS, MAP_SPREAD = 5, 0.5, 0.004  # of a line in a map: at least, px, and 4 mm of its worse end at a metre


@dataclass(frozen=True)
class Triangulated:
    """Lines, or points, and what can be said of them. Row k of every array is track k.

    Attributes:
        ends: (N, 2, 3) of lines, what at least `PART_VIEWS` views saw of them; (N, 1, 3) points.
        rms: (N,) distance of the observations from their images, on the plane z = 1.
        spread: (N,) standard deviation of the worse end across the line, as share of its distance from the cameras.
        ahead: (N,) whether it lies before all cameras that saw it, and they saw the same of it.
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
    middle = seen.sums(own[:, :, 3]) / counts[:, None]
    points, along = _meet(seen, own, middle)
    points = _reach(seen, points, along, own)[0].mean(axis=1)
    far = np.linalg.norm(points - middle, axis=1)[:, None, None] + TINY
    pair = points[:, None] + far * np.array([[-APART], [APART]]) * along[:, None]
    for _ in range(STEPS):
        errors, slopes, across = _slopes(seen, pair, own)
        weight = np.minimum(1, HUBER / np.maximum(np.linalg.norm(errors, axis=1), TINY))[:, None, None]
        turned = (weight * slopes).transpose(0, 2, 1)
        hessian = seen.sums(turned @ slopes)
        hessian += (1e-9 * np.einsum("nii->n", hessian) + TINY)[:, None, None] * np.eye(4)
        step = np.linalg.solve(hessian, seen.sums(turned @ errors[:, :, None]))
        pair = pair - step.reshape(-1, 2, 2) @ across
    errors = _slopes(seen, pair, own)[0]
    along = pair[:, 1] - pair[:, 0]
    size = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), TINY)
    ends, overlap = _reach(seen, pair[:, 0], along / size, own)
    share = (
        np.linalg.norm(ends - pair[:, :1], axis=2) * np.sign(((ends - pair[:, :1]) * along[:, None]).sum(axis=2)) / size
    )
    parts = np.stack([1 - share, share], axis=2)  # of the pair's two points in each end
    blocks = np.linalg.inv(hessian).reshape(-1, 2, 2, 2, 2)
    surprise = np.maximum(1, seen.sums((errors**2).mean(axis=1)) / counts)
    spread = np.sqrt(surprise[:, None] * np.einsum("nei,nej,nikjk->ne", parts, parts, blocks)).max(axis=1)
    depth = np.einsum("mki,mi->mk", ends[seen.row] - own[:, None, :, 3], own[:, :, 2])
    found = _judged(seen, ends, end_errors(seen.seen, errors), spread, depth, middle)
    return replace(found, ahead=found.ahead & overlap)


def _slopes(seen: Observations[Lines], pair: Array, poses: Array) -> tuple[Array, Array, Array]:
    """(M, 2) whitened errors, (M, 2, 4) derivatives by shifts of both points across, and (N, 2, 3) these directions."""
    along = pair[:, 1] - pair[:, 0]
    least = np.eye(3)[np.abs(along).argmin(axis=1)]
    one = np.cross(along, least)
    other = np.cross(along, one)
    across = np.stack(
        [side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), TINY) for side in (one, other)], axis=1
    )
    local = np.einsum("mki,mij->mkj", pair[seen.row] - poses[:, None, :, 3], poses[:, :, :3])
    sides = across[seen.row] @ poses[:, :, :3]
    errors, by_image, _ = line_errors(seen.seen, local[:, 0], local[:, 1])
    moved = np.concatenate([np.cross(sides, local[:, 1:]), -np.cross(sides, local[:, :1])], axis=1)
    return errors, by_image @ moved.transpose(0, 2, 1), across


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
    seen: Observations[Lines] | Observations[Points],
    ends: Array,
    off: Array,
    spread: Array,
    depth: Array,
    middle: Array,
) -> Triangulated:
    far = np.linalg.norm(ends - middle[:, None], axis=2).max(axis=1)
    rms = np.sqrt(seen.sums((off**2).mean(axis=1)) / np.maximum(seen.counts, 1))
    ahead = np.minimum.reduceat(depth.min(axis=1), seen.starts) > 0 if len(ends) else np.zeros(0, np.bool_)
    return Triangulated(ends, rms, spread / np.maximum(far, TINY), ahead)


def _meet(seen: Observations[Lines], poses: Array, middle: Array) -> tuple[Array, Array]:
    """(N, 3) points and unit directions of lines, in which the planes of the observations meet.

    An observation spans a plane through the camera's centre. The two planes that say most of a line's are the largest
    eigenvectors of the planes' moment matrix (Hartley and Zisserman 2004, 12.7).
    """
    planes = np.einsum("mij,mj->mi", poses[:, :, :3], seen.seen.lines)
    centres = poses[:, :, 3] - middle[seen.row]
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


def _reach(
    seen: Observations[Lines], points: Array, directions: Array, poses: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """(N, 2, 3) first and last point of lines that `PART_VIEWS` views saw, and whether there is anything between.

    Points are where lines come nearest to the rays of the observed ends.
    """
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
    return points[:, None] + reach[:, :, None] * directions[:, None], reach[:, 0] < reach[:, 1]

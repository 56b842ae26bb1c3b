"""Lines in space from their images under known poses, and how well they are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from line_odometry.adjust import Equations, costs, fit_lines
from line_odometry.geometry import TINY, Array
from line_odometry.views import Ids, Observations, View, gather

LEAST_NOISE = 0.15  # px: agreement closer than this is luck
PART_VIEWS = 3  # views that a part of a line must have been seen in
MAP_VIEWS, MAP_RMS, MAP_SPREAD = 5, 1.0, 0.004  # of a line in a map: at least, px, and 4 mm of its worse end at a metre


@dataclass(frozen=True)
class Triangulated:
    """Lines and what can be said of them. Row k of every array is line k.

    Attributes:
        lines: (N, 2, 3) points, in the middle of what was seen, and unit directions.
        rms: (N,) distance of the observed end points, px.
        reach: (N, 2) where on the line, from its point, it begins and ends: what at least `PART_VIEWS` views saw of it.
        spread: (N,) standard deviation of the worse end across the line, as share of its distance from the cameras.
        ahead: (N,) whether all that was seen of it lies before the cameras.
    """

    lines: Array
    rms: Array
    reach: Array
    spread: Array
    ahead: NDArray[np.bool_]

    @property
    def segments(self) -> Array:
        """(N, 2, 3) end points in space."""
        return self.lines[:, :1] + self.reach[:, :, None] * self.lines[:, 1:]


def map_lines(views: Sequence[View], poses: Array, focal: float) -> tuple[Ids, Array]:
    """Tracks (N,) and end points in space (N, 2, 3) of the lines that views agree on from poses (K, 3, 4)."""
    seen = gather(views, focal, MAP_VIEWS)
    found = triangulate(seen, poses)
    good = found.ahead & (found.rms < MAP_RMS) & (found.spread < MAP_SPREAD)
    return seen.ids[good], found.segments[good]


def triangulate(seen: Observations, poses: Array, start: Array | None = None) -> Triangulated:
    """Lines that fit what was seen of them in two views or more.

    Args:
        seen: the observations.
        poses: (K, 3, 4).
        start: (N, 2, 3) lines to start from, NaN where there is none.
    """
    lines = meet_planes(seen, poses)
    if start is not None:
        lines = np.where(np.isfinite(start), start, lines)
    return judge(seen, fit_lines(seen, lines, poses, steps=4), poses)


def meet_planes(seen: Observations, poses: Array) -> Array:
    """(N, 2, 3) the lines in which the planes of the observations meet, by linear least squares.

    An observation spans a plane through the camera's centre. The two planes that say most of a line's are the largest
    eigenvectors of the planes' moment matrix (Hartley and Zisserman 2004, 12.7).
    """
    own = poses[seen.view]
    normals = np.einsum("mij,mj->mi", own[:, :, :3], np.cross(seen.ends[:, 0], seen.ends[:, 1]))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), TINY)
    middle = seen.sums(own[:, :, 3]) / seen.counts[:, None]
    centres = own[:, :, 3] - middle[seen.line]
    unit = np.sqrt(seen.sums((centres**2).sum(axis=1)) / seen.counts) + TINY
    planes = np.column_stack([normals, -(normals * centres).sum(axis=1) / unit[seen.line]])
    two = np.linalg.eigh(seen.sums(planes[:, :, None] * planes[:, None]))[1][:, :, 2:]
    (n, m), (a, b) = np.moveaxis(two[:, :3], 2, 0), np.moveaxis(two[:, 3:], 2, 0)
    directions = np.cross(n, m)
    size = np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), TINY)
    points = np.cross(b * n - a * m, directions) / size**2
    alone = size[:, 0] <= TINY  # planes that coincide tell no line: any will do, it is found wanting later
    directions = np.where(alone[:, None], (1.0, 0.0, 0.0), directions / size)
    return np.stack([points * unit[:, None] + middle, directions], axis=1)


def judge(seen: Observations, lines: Array, poses: Array) -> Triangulated:
    """What the observations say of lines that were fitted to them."""
    own, counts = poses[seen.view], np.maximum(seen.counts, 1)
    depth, along = _nearest(seen.ends.mean(axis=1), lines[seen.line], own)
    lines = lines.copy()
    lines[:, 0] += (seen.sums(along) / counts)[:, None] * lines[:, 1]
    sides = [_nearest(seen.ends[:, end], lines[seen.line], own) for end in range(2)]
    nearest = np.minimum(sides[0][0], sides[1][0])
    reach = _covered(seen, np.sort(np.stack([sides[0][1], sides[1][1]], axis=1), axis=1))
    rms = np.sqrt(costs(seen, lines, poses) / counts)
    covariance = np.linalg.inv(Equations.at(seen, lines, poses).hessian)
    far = np.abs(reach).max(axis=1)
    variance = np.zeros(len(lines))
    for k in range(2):  # the shift across the line, and the turn that moves its ends, both with their correlation
        shift, both, turn = covariance[:, k, k], np.abs(covariance[:, k, k + 2]), covariance[:, k + 2, k + 2]
        variance += shift + 2 * far * both + far**2 * turn
    distance = np.maximum(np.abs(seen.sums(depth)) / counts, TINY)
    spread = np.maximum(rms, LEAST_NOISE) * np.sqrt(variance) / distance
    ahead = np.minimum.reduceat(nearest, seen.starts) > 0 if len(lines) else np.zeros(0, np.bool_)
    return Triangulated(lines, rms, reach, spread, ahead & (reach[:, 0] < reach[:, 1]))


def _nearest(points: Array, lines: Array, poses: Array) -> tuple[Array, Array]:
    """(M,) depths and (M,) places along lines (M, 2, 3) where they come nearest to the rays of image points (M, 3)."""
    rays = np.einsum("mij,mj->mi", poses[:, :, :3], points)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    away = lines[:, 0] - poses[:, :, 3]
    cosine = (lines[:, 1] * rays).sum(axis=1)
    along = (cosine * (rays * away).sum(axis=1) - (lines[:, 1] * away).sum(axis=1)) / np.maximum(1 - cosine**2, TINY)
    found = lines[:, 0] + along[:, None] * lines[:, 1]
    return np.einsum("mi,mi->m", found - poses[:, :, 3], poses[:, :, 2]), along


def _covered(seen: Observations, spans: Array) -> Array:
    """(N, 2) first and last place that `PART_VIEWS` of a line's spans (M, 2) reach."""
    reach = np.zeros((len(seen.ids), 2))
    for row, (start, count) in enumerate(zip(seen.starts.tolist(), seen.counts.tolist(), strict=True)):
        own, k = spans[start : start + count], min(PART_VIEWS, count) - 1
        reach[row] = np.partition(own[:, 0], k)[k], -np.partition(-own[:, 1], k)[k]
    return reach

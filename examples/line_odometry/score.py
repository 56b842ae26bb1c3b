"""How good a path and a map are: evo for the path, LIMAP's two shares for the lines."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from evo.core.metrics import APE, PoseRelation, StatisticsType
from evo.core.trajectory import PosePath3D

from line_odometry.views import TINY, Array

MAX_ANGLE = 10.0  # degrees between a line and the one that it is near to
STEP = 0.01  # share of the depth between samples of a line
CHUNK = 256  # samples that are compared at once


@dataclass(frozen=True)
class Aligned:
    """A path laid over the true one by the best similarity, or motion (Umeyama 1991), and how far it is from it.

    Attributes:
        poses: (N, 3, 4) world_from_camera.
        turn, shift, scale: of that (1 of a motion): X_world = scale * turn @ X + shift.
        ate_percent: absolute trajectory error, rms, as share of the path's length.
        rotation_deg: rms angle between both cameras when they start alike; a straight path does not fix the turn about
            itself, so it is not that which turns them here.
    """

    poses: Array
    turn: Array
    shift: Array
    scale: float
    ate_percent: float
    rotation_deg: float


def align(poses: Array, true: Array, *, metres: bool = False) -> Aligned:
    """Compare a path (N, 3, 4) with the true one, whose scale it has, or must be given."""
    path, reference = _path(poses), _path(true)
    moved, begun = copy.deepcopy(path), copy.deepcopy(path)
    turn, shift, scale = moved.align(reference, correct_scale=not metres)
    begun.align_origin(reference)
    errors = []
    for estimate, relation in ((moved, PoseRelation.translation_part), (begun, PoseRelation.rotation_angle_deg)):
        metric = APE(relation)
        metric.process_data((reference, estimate))
        errors.append(float(metric.get_statistic(StatisticsType.rmse)))
    ate_percent = 100 * errors[0] / reference.path_length
    return Aligned(np.array(moved.poses_se3)[:, :3], turn, shift, float(scale), ate_percent, errors[1])


def _path(poses: Array) -> PosePath3D:
    return PosePath3D(poses_se3=[np.vstack([pose, (0, 0, 0, 1)]) for pose in poses])


@dataclass(frozen=True)
class TrueLines:
    """The lines of a known world.

    Attributes:
        visible: (V, 2, 3) all that could be seen of them over the clip, each part once.
        every: (A, 2, 3) all there are: who finds a line too faint to be asked for has not made it up.
        depth: the scene's, median over the clip.
    """

    visible: Array
    every: Array
    depth: float


def mapped(segments: Array, true: TrueLines, tolerance: float = 0.02) -> tuple[float, float]:
    """Percent of the visible length that a map covers, and percent of the map's length that is true.

    A point is covered by lines within the tolerance, a share of the scene's depth, that run its way within 10 degrees.

    Args:
        segments: (N, 2, 3) the map.
        true: the world.
        tolerance: share of the depth.
    """
    near = tolerance * true.depth
    step = STEP * true.depth
    return _covered(true.visible, segments, near, step), _covered(segments, true.every, near, step)


def _covered(segments: Array, by: Array, near: float, step: float) -> float:
    """Percent of the length of segments (N, 2, 3) that others (M, 2, 3) cover, looked at every `step`."""
    if not len(segments) or not len(by):
        return 0.0
    points, directions, lengths = _samples(segments, step)
    along = by[:, 1] - by[:, 0]
    size = np.maximum(np.linalg.norm(along, axis=1), TINY)
    along /= size[:, None]
    starts_along, starts_squared = (by[:, 0] * along).sum(axis=1), (by[:, 0] ** 2).sum(axis=1)
    covered = 0.0
    for first in range(0, len(points), CHUNK):
        part = slice(first, first + CHUNK)
        place = points[part] @ along.T - starts_along
        beyond = place - np.clip(place, 0, size)
        from_start = (points[part] ** 2).sum(axis=1)[:, None] - 2 * points[part] @ by[:, 0].T + starts_squared
        squared = from_start - place**2 + beyond**2
        alike = np.abs(directions[part] @ along.T) > np.cos(np.deg2rad(MAX_ANGLE))
        covered += lengths[part][((squared < near**2) & alike).any(axis=1)].sum()
    return float(100 * covered / lengths.sum())


def _samples(segments: Array, step: float) -> tuple[Array, Array, Array]:
    """Points at most `step` apart on segments, the unit direction and the length that each stands for."""
    along = segments[:, 1] - segments[:, 0]
    size = np.linalg.norm(along, axis=1)
    count = np.maximum(1, np.ceil(size / step).astype(int))
    row = np.repeat(np.arange(len(segments)), count)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[row]
    directions = along / np.maximum(size, TINY)[:, None]
    return segments[row, 0] + share[:, None] * along[row], directions[row], (size / count)[row]

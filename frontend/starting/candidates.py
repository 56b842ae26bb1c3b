"""How the camera may have moved between three views: by points, by corners, and by vanishing directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airline.errors import from_extra
from frontend.starting.agreement import ROBUST
from frontend.starting.views import POINT_ERROR, TINY, Array, Ids, Seen, View, common

with from_extra("poses"):
    import poselib

LEAST = 6  # points that agree, of a relative pose; lines and points, of a pose
MAX_ERROR = 1.5  # px, of one that agrees
NEAR = 3.0  # standard deviations of an inverse depth, from which a line or point is near enough to find poses by
PARALLEL = 0.02  # radians between a line and its vanishing direction
LEAST_PARALLEL = 3  # lines
APART = 0.87  # cosine of the angle between two vanishing directions, at most
MOST_PAIRS = 1500  # of lines that are tried
_IDEAL = {"model": "PINHOLE", "width": 1, "height": 1, "params": [1.0, 1.0, 0.0, 0.0]}  # points on the plane z = 1


def candidates(seen: Seen) -> list[tuple[str, Array]]:
    """What told a motion, and the (2, 3, 4) motion."""
    found = []
    for by, rows in (("points", slice(0, seen.flow)), ("corners", slice(seen.flow, None))):
        last = _essential(seen.rays[0, rows], seen.rays[2, rows], seen.views[0].focal)
        middle = None if last is None else Space.of(seen, last).pose_of(seen.views[1])
        if last is not None and middle is not None:
            found.append((by, np.stack([middle, last])))
    turns = _by_vanishing_directions([view.normals for view in seen.views])
    centres = None if turns is None else _centres(seen, turns)
    if turns is not None and centres is not None:
        found.append(("vanishing directions", np.concatenate([turns, centres[..., None]], axis=2)))
    return [(by, motion) for by, motion in found if np.isfinite(motion).all()]


def _essential(here: Array, there: Array, focal: float) -> Array | None:
    """(3, 4) the second pose by PoseLib's essential matrix from points (M, 3); None where too few agree."""
    if len(here) < LEAST:
        return None
    options = {"max_epipolar_error": MAX_ERROR / focal, "min_iterations": 100, "max_iterations": 1000, "seed": 0}
    pose, report = poselib.estimate_relative_pose(here[:, :2], there[:, :2], _IDEAL, _IDEAL, options, {})
    found = _world_from_camera(pose)
    found[:, 3] /= float(np.linalg.norm(found[:, 3])) + TINY
    return found if report["num_inliers"] >= LEAST else None


def _by_vanishing_directions(normals: list[Array]) -> Array | None:
    """(2, 3, 3) rotations of the middle and the last view, by two directions that the same lines have in all views."""
    n = np.stack([own / np.linalg.norm(own, axis=1, keepdims=True) for own in normals])
    pairs = np.stack(np.triu_indices(n.shape[1], 1))
    pairs = np.random.default_rng(0).permutation(pairs, axis=1)[:, :MOST_PAIRS]
    directions = np.cross(n[:, pairs[0]], n[:, pairs[1]])
    size = np.linalg.norm(directions, axis=2)
    directions = directions[:, (size > PARALLEL).all(axis=0)] / size[:, (size > PARALLEL).all(axis=0), None]
    axes: list[Array] = []
    free = np.ones(n.shape[1], np.bool_)
    while len(axes) < 2:
        belong = (np.abs(directions @ n.swapaxes(1, 2)) < PARALLEL).all(axis=0) & free
        own = belong[belong.sum(axis=1).argmax()] if len(belong) else free & False
        if own.sum() < LEAST_PARALLEL:
            return None
        axis = np.linalg.svd(n[:, own])[2][:, 2]
        axes.append(axis * np.where(axis @ axis[0] < 0, -1, 1)[:, None])  # the camera turned by less than 90 degrees
        free &= ~own
        directions = directions[:, np.abs(directions[0] @ axis[0]) < APART]
    return np.stack([aligned(np.stack(axes)[:, 0], np.stack(axes)[:, view]) for view in (1, 2)])


def _centres(seen: Seen, turns: Array) -> Array | None:
    """(2, 3) the centres by robust linear least squares, the rotations (2, 3, 3) being known; None where they are one.

    What `residuals` makes small is linear in the centres then: that of the lines along the line, that of the points.
    """
    turned = np.concatenate([np.eye(3)[None], turns]).swapaxes(1, 2)
    n = np.stack([view.normals / np.linalg.norm(view.normals, axis=1, keepdims=True) for view in seen.views]) @ turned
    rays = seen.rays @ turned
    far = np.cross(n[1], n[0])[:, :, None] * n[2][:, None]
    near = np.cross(n[1], n[2])[:, :, None] * n[0][:, None]
    last, both, none = np.cross(rays[0], rays[2]), np.cross(rays[1], rays[2]), np.zeros_like(rays[0])
    points = np.concatenate(
        [np.hstack(pair) for pair in ((np.cross(rays[0], rays[1]), none), (none, last), (-both, both))]
    )
    rows = np.concatenate([np.concatenate([far - near, -far], axis=2).reshape(-1, 6), points])
    weights, centres = np.ones(len(rows)), np.zeros((2, 3))
    for _ in range(6):
        centres = np.linalg.svd(rows * weights[:, None], full_matrices=False)[2][-1].reshape(2, 3)
        off = np.abs(rows @ centres.ravel())
        weights = 1 / np.sqrt(off + np.median(off) + TINY)
    size = np.linalg.norm(centres[1])
    return centres / size if size > TINY else None


def aligned(here: Array, there: Array) -> Array:
    """(3, 3) the rotation that brings directions (N, 3) nearest to others (Kabsch 1976)."""
    u, _, v = np.linalg.svd(here.T @ there)
    return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v)


def turned(first: View, second: View) -> tuple[Array, float]:
    """(3, 3) the rotation that explains most of two views, and how far off the worst fifth is, standard deviations."""
    one, two = common([first, second])
    here, there = (np.concatenate([view.normals, view.points]) for view in (one, two))
    size, point = np.linalg.norm(here, axis=1), POINT_ERROR / first.focal
    here, there = here / size[:, None], there / np.linalg.norm(there, axis=1, keepdims=True)
    variances = np.full(len(here), 2 * point**2)
    variances[: len(one.ids)] = ((one.errors**2 + two.errors**2).sum(axis=(0, 2))) / size[: len(one.ids)] ** 2
    middle, turn, squares = one.ends.mean(axis=0), np.eye(3), np.zeros(len(here))
    for _ in range(6 if len(here) else 0):
        turn = aligned(here / (variances * (1 + squares / ROBUST))[:, None], there)
        off = (two.normals @ turn.T * middle).sum(axis=1)
        own, other = one.across.mean(axis=1), (two.errors @ turn.T * middle).sum(axis=2)
        lines = off**2 / (own**2 + other**2).sum(axis=0)
        points = np.linalg.norm(here - there @ turn.T, axis=1)[len(lines) :] / point
        squares = np.concatenate([lines, points**2 / 2])
    return turn, float(np.sqrt(np.quantile(squares, 0.8))) if len(squares) else 0.0


def directions(seen: Seen) -> Array:
    """(7, 2, 3, 4) motions along the axes and the diagonals, to start from where nothing tells them."""
    towards = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1)], np.float64)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    turns = np.stack([turned(seen.views[0], view)[0] for view in seen.views[1:]])
    centres = np.stack([towards / 2, towards], axis=1)[..., None]
    return np.concatenate([np.broadcast_to(turns, (len(towards), 2, 3, 3)), centres], axis=3)


def beside(motion: Array, angle: float) -> Array:
    """(4, 2, 3, 4) the motion (2, 3, 4) turned to four sides, so that the last centre is at an angle, radians."""
    across = np.linalg.svd(motion[None, 1, :, 3])[2][1:]
    step = np.tan(angle) * np.concatenate([across, -across])
    share = np.linalg.norm(motion[:, :, 3], axis=1)
    beside = np.tile(motion, (4, 1, 1, 1))
    beside[..., 3] += share[:, None] * step[:, None]
    beside[..., 3] *= np.cos(angle)
    return beside


def inverse_depths(seen: Seen, last: Array) -> tuple[Array, Array, Array, Array]:
    """In the first view, of both ends of lines (2, N) and of points (M,), each with its standard deviations."""
    first, _, view = seen.views
    turn, centre = last[:, :3], last[:, 3]
    planes, errors = view.normals @ turn.T, view.errors @ turn.T
    base = planes @ centre
    base = np.where(np.abs(base) < TINY, TINY, base)
    depths = (first.ends * planes).sum(axis=2) / base
    by_last = (errors[:, None] * first.ends).sum(axis=3) - depths * (errors @ centre)[:, None]
    by_first = (planes * first.normals * (1, 1, 0)).sum(axis=1) * first.across
    sigmas = np.sqrt((by_last**2).sum(axis=0) + (by_first**2).sum(axis=0)) / np.abs(base)
    x, infinite, step = seen.rays[2, :, :2], seen.rays[0] @ turn, -centre @ turn
    gap, slope = x * infinite[:, 2:] - infinite[:, :2], step[:2] - x * step[2]
    square = (slope**2).sum(axis=1) + TINY
    own = np.sqrt(2 / square) * seen.sigmas * np.abs(infinite[:, 2])
    return depths, sigmas, (gap * slope).sum(axis=1) / square, own


@dataclass(frozen=True)
class Space:
    """Lines and points in space: ids (N,), ends (2, N, 3), point ids (P,), points (P, 3); the focal length, px."""

    ids: Ids
    ends: Array
    point_ids: Ids
    points: Array
    focal: float

    @staticmethod
    def of(seen: Seen, last: Array) -> Space:
        """Those that are near enough to be known from the first view and the last, at a pose (3, 4)."""
        depths, sigmas, of_points, own = (
            part[..., : seen.flow] if k > 1 else part for k, part in enumerate(inverse_depths(seen, last))
        )
        first, near, points = seen.views[0], (depths > NEAR * sigmas).all(axis=0), of_points > NEAR * own
        ends, space = first.ends[:, near] / depths[:, near, None], first.points[points] / of_points[points, None]
        return Space(first.ids[near], ends, first.point_ids[points], space, first.focal)

    def pose_of(self, view: View) -> Array | None:
        """(3, 4) the pose of a view by PoseLib's RANSAC on points and lines; None where too few agree."""
        _, mine, lines = np.intersect1d(self.ids, view.ids, assume_unique=True, return_indices=True)
        _, own, points = np.intersect1d(self.point_ids, view.point_ids, assume_unique=True, return_indices=True)
        if len(mine) + len(own) < LEAST:
            return None
        pose, report = poselib.estimate_absolute_pose_pnpl(
            view.points[points, :2],
            self.points[own],
            *view.ends[:, lines, :2],
            *self.ends[:, mine],
            _IDEAL,
            {"max_reproj_error": MAX_ERROR / self.focal, "min_iterations": 30, "max_iterations": 300, "seed": 0},
            {"loss_type": "HUBER", "loss_scale": 0.5 / self.focal},
        )
        return _world_from_camera(pose) if report["num_inliers"] >= LEAST else None


def _world_from_camera(pose: poselib.CameraPose) -> Array:
    turn = np.asarray(pose.R).T
    return np.column_stack([turn, -turn @ np.asarray(pose.t)])

"""The start of a monocular map: the poses of the first frames, from lines that were tracked, and points where there are.

    frames = []
    for tracks in LineFrontend().stream(source):
        frames.append(tracks)
        begun = start(frames)
        if not begun.waits:
            break  # begun.poses
        del frames[: begun.drop]

Lines say nothing of two views, for any two planes meet; what moves is told by points, by corners, where lines meet, and
by the vanishing directions of parallel lines. Each may be wrong, so each is but a candidate: it is adjusted to all that
three views saw, the first, the last and one between, and the one that lines and points agree with best is taken.

The views' poses alone are adjusted: no line in space is. The planes of a line seen from the first view and the last meet
in a line that the middle view must see where it saw it (Hartley and Zisserman 2004, 15.2): two equations a line; points
give one a pair of views. Residuals are divided by their standard deviations to first order (Sampson's approximation,
4.2.6), with the covariances that the tracker gives, so that a line that tells nothing weighs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError, from_extra
from frontend.tracks import LineTracks

with from_extra("poses"):
    import poselib

LEAST_LINES, LEAST_TRACKS = 8, 16  # that go on from the first frame to the last: lines, lines and points
MOST_LINES, MOST_POINTS = 120, 150  # that are looked at
MOST_FRAMES = 120  # of which none tells the motion, after which the oldest go
POINT_ERROR, CORNER_ERROR = 0.2, 0.4  # px, standard deviation
MEETING = 6.0  # px from both lines' ends to where they meet, of a corner
LEAST_SINE = 0.35  # between them: the corner of near-parallel lines is anywhere
PARALLEL = 0.02  # radians between a line and its vanishing direction
MOVED = 0.1  # share of tracks that a turn must not explain
SURE = 0.035  # radians, standard deviation of the direction of motion
STEPS = 8
ROBUST = 2.0  # squared standard deviations: Cauchy's scale
AGREES = 9.2  # squared distance, two degrees of freedom, 99 %
LEAST_AGREEMENT = 0.6
ALIKE = 20.0  # of the cost
TINY = 1e-12
_IDEAL = {"model": "PINHOLE", "width": 1, "height": 1, "params": [1.0, 1.0, 0.0, 0.0]}  # points on the plane z = 1

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


@dataclass(frozen=True)
class Begun:
    """How a map begins, or why it waits.

    Attributes:
        poses: (K, 3, 4) float64 world_from_camera of the K frames, in the first one's axes; from the first to the last
            is 1, for one camera does not know scale. (0, 3, 4) while it waits.
        by: "points", "corners" or "vanishing directions": what told the motion; "" while it waits.
        agreement: share of the lines which three views agree on, of those that tell anything.
        error: standard deviation of the direction of motion, radians.
        waits: "" once begun, else why not.
        drop: how many of the oldest frames are of no more use.
    """

    poses: Array
    by: str = ""
    agreement: float = 0.0
    error: float = np.inf
    waits: str = ""
    drop: int = 0


@dataclass(frozen=True)
class _View:
    """Lines and points of a frame on the plane z = 1, ids ascending.

    Attributes:
        ids, confirmed: (N,) of whole lines, for their longest pieces.
        ends: (2, N, 3) the line's middle, and half the way from end to end.
        normals: (N, 3) its coefficients.
        errors: (2, N, 3) what these change by for one standard deviation each of two independent errors,
        across: (2, 2, N) and how far middle and end then go across.
        point_ids, points: (P,), (P, 3).
        focal: px.
    """

    ids: Ids
    confirmed: NDArray[np.bool_]
    ends: Array
    normals: Array
    errors: Array
    across: Array
    point_ids: Ids
    points: Array
    focal: float

    @staticmethod
    def of(tracks: LineTracks) -> _View:
        ends, covariances, lines = tracks.observed_normalized, tracks.observed_line_covariances, tracks.observed_lines
        if tracks.camera is None or ends is None or covariances is None or lines is None:
            raise ConfigError("a start needs a camera: give the source a calibration (--calib)")
        whole = np.where(tracks.fragment_of >= 0, tracks.fragment_of, tracks.ids)
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        good = np.flatnonzero(np.isfinite(covariances).all(axis=(1, 2)) & (length > 0))
        order = good[np.lexsort((-length[good], whole[good]))]
        ids, first = np.unique(whole[order], return_index=True)
        rows = order[first]
        n, (start, end) = np.float64(lines[rows]), np.moveaxis(_rays(ends[rows]), 1, 0)
        middle, half = (start + end) / 2, (end - start) / 2
        own = np.linalg.cholesky(np.float64(covariances[rows]) + TINY * np.eye(2))
        by_angle = np.column_stack([-n[:, 1], n[:, 0], n[:, 1] * middle[:, 0] - n[:, 0] * middle[:, 1]])
        by_offset = np.zeros_like(n) - (0, 0, 1)
        errors = own[:, 0, :, None] * by_offset[:, None] + own[:, 1, :, None] * by_angle[:, None]
        across = own.copy()
        across[:, 1] *= length[rows, None] / 2
        points = tracks.points_normalized
        known = np.isfinite(points).all(axis=1)
        return _View(
            ids,
            tracks.confirmed[rows],
            np.stack([middle, half]),
            n,
            np.moveaxis(errors, 1, 0),
            np.moveaxis(across, 0, 2),
            tracks.point_ids[known],
            _rays(points[known]),
            float(tracks.camera.matrix[0, 0]),
        )


@dataclass(frozen=True)
class _Seen:
    """Lines and points that the same three views saw, first, middle and last; shapes as in `_View`, a list of three."""

    views: list[_View]
    rays: Array  # (3, M, 3) flow points, then corners
    sigmas: Array  # (M,)
    flow: int  # how many are flow points

    @staticmethod
    def of(views: Sequence[_View]) -> _Seen:
        lines = _common([view.ids for view in views[:2]] + [views[2].ids[views[2].confirmed]], MOST_LINES)
        points = _common([view.point_ids for view in views], MOST_POINTS)
        found = []
        for view in views:
            rows, own = np.searchsorted(view.ids, lines), np.searchsorted(view.point_ids, points)
            found.append(
                _View(
                    lines, view.confirmed[rows], view.ends[:, rows], view.normals[rows], view.errors[:, rows],
                    view.across[..., rows], points, view.points[own], view.focal,
                )
            )  # fmt: skip
        corners = _corners(found)
        rays = np.concatenate([np.stack([view.points for view in found]), corners], axis=1)
        sigmas = np.repeat([POINT_ERROR, CORNER_ERROR], [len(points), corners.shape[1]]) / found[0].focal
        return _Seen(found, rays, sigmas, len(points))

    def residuals(self, turns: Array, centres: Array) -> tuple[Array, Array]:
        """In standard deviations, (B, 2, N) of the lines and (B, 3, M) of the points.

        Args:
            turns: (B, 2, 3, 3) rotations of the middle and the last view.
            centres: (B, 2, 3) their centres.
        """
        first, middle, last = self.views
        back = turns.swapaxes(2, 3)
        mid, ends = centres[:, 0, :, None], middle.ends @ back[:, :1]
        base = mid - centres[:, 1, :, None]
        plane, plane_errors = last.normals @ back[:, 1], last.errors @ back[:, 1:]
        far, near = (plane @ base)[..., 0], (first.normals @ mid)[..., 0]
        seen = far[..., None] * first.normals - near[..., None] * plane
        gap = np.einsum("bnc,bknc->bkn", seen, ends)
        by_first = far[:, None, None] * np.einsum("bknc,enc->bken", ends, first.errors)
        by_first -= np.einsum("bknc,bnc->bkn", ends, plane)[:, :, None] * (first.errors @ mid[:, None])[:, None, ..., 0]
        by_last = np.einsum("bknc,nc->bkn", ends, first.normals)[:, :, None] * (plane_errors @ base[:, None])[:, None, ..., 0]
        by_last -= near[:, None, None] * np.einsum("bknc,benc->bken", ends, plane_errors)
        flat = middle.normals * (1, 1, 0) @ back[:, 0]
        by_middle = np.einsum("bnc,bnc->bn", seen, flat)[:, None, None] * middle.across
        by = np.concatenate([by_first, by_middle, by_last], axis=2)
        (xx, xy), yy = np.einsum("ben,bken->kbn", by[:, 0], by), (by[:, 1] ** 2).sum(axis=1)
        xx = np.sqrt(xx) + TINY**2
        lines = np.stack([gap[:, 0] / xx, (gap[:, 1] - xy / xx**2 * gap[:, 0]) / np.sqrt(np.maximum(yy - (xy / xx) ** 2, TINY**2))], axis=1)

        rays = [np.broadcast_to(self.rays[0], (len(turns), *self.rays[0].shape)), *(self.rays[k] @ back[:, k - 1] for k in (1, 2))]
        points = []
        for i, j in ((0, 1), (0, 2), (1, 2)):
            step = (centres[:, j - 1] - (centres[:, i - 1] if i else 0))[:, None]
            here, there = np.cross(rays[j], step), np.cross(step, rays[i])
            off = (rays[i] * here).sum(axis=2)
            here, there = here @ turns[:, i - 1] if i else here, there @ turns[:, j - 1]
            points.append(off / (self.sigmas * np.sqrt((here[..., :2] ** 2).sum(axis=2) + (there[..., :2] ** 2).sum(axis=2)) + TINY**2))
        return lines, np.stack(points, axis=1)


@dataclass(frozen=True)
class _Motion:
    """A candidate: (2, 3, 3) rotations and (2, 3) centres of the middle and the last view, and what told it."""

    turns: Array
    centres: Array
    by: str


def start(frames: Sequence[LineTracks]) -> Begun:
    """The poses of all frames, or why they cannot be known yet.

    Args:
        frames: consecutive ones, each with a camera. Call it again with each new one; see `Begun.drop`.

    Raises:
        ConfigError: a frame without a camera.
    """
    if len(frames) < 3:
        return Begun(_none(), waits="too few frames", drop=0)
    views = {k: _View.of(frames[k]) for k in sorted({*np.linspace(0, len(frames) - 1, 6).astype(int).tolist()})}
    ends = [views[0], views[len(frames) - 1]]
    common = len(_common([view.ids for view in ends])), len(_common([view.point_ids for view in ends]))
    if common[0] < LEAST_LINES or sum(common) < LEAST_TRACKS:
        return Begun(_none(), waits="too few lines and points go on", drop=1)
    drop = max(0, len(frames) - MOST_FRAMES)
    turn, moved = _turned(*ends)
    if moved < MOVED:
        angle = np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        what = f"only turned so far, by {angle:.0f} degrees" if angle > 1 else "not moved so far"
        return Begun(_none(), waits=f"the camera has {what}", drop=drop)
    between = [k for k in views if 0 < k < len(frames) - 1]
    middle = max(between, key=lambda k: min(_turned(ends[0], views[k])[1], _turned(views[k], ends[1])[1]))
    seen = _Seen.of([ends[0], views[middle], ends[1]])
    motions = _candidates(seen)
    if not motions:
        return Begun(_none(), waits="nothing tells yet how the camera moved", drop=drop)
    turns, centres, costs, covariances = _adjusted(seen, motions)
    order = np.argsort(costs, kind="stable")
    best = int(order[0])
    depths, sigmas, of_points, point_sigmas = _inverse_depths(seen, turns[best, 1], centres[best, 1])
    ahead = np.concatenate([(depths / sigmas).mean(axis=0), of_points / point_sigmas])
    if np.clip(ahead, -3, 3).sum() < 0:
        centres[best], ahead = -centres[best], -ahead
    lines, points = seen.residuals(turns[best : best + 1], centres[best : best + 1])
    agree = ((lines[0] ** 2).sum(axis=0) < AGREES) & (ahead[: lines.shape[2]] > -3)
    noise = max(1.0, float((np.median((lines**2).sum(axis=1))) / 1.386))
    error = float(np.sqrt(noise * np.linalg.eigvalsh(covariances[best, 9:, 9:]).max()))
    global LAST
    LAST = dict(turn=turns[best, 1], centre=centres[best, 1], z=np.abs(ahead), cost=costs[best], costs=costs, cents=centres, n=lines.shape[2], m=len(of_points), flow=seen.flow, sgn=np.clip(ahead, -3, 3).sum() / len(ahead), moved=moved, error=error, agree=float(agree.mean()), rot=float(_costs(*seen.residuals(turns[best : best + 1], centres[best : best + 1]))[0]), by=motions[best].by, angle=turn, tells=np.sqrt(np.diagonal(covariances[best])))
    said = dict(by=motions[best].by, agreement=float(agree.mean()), error=error, drop=drop)
    for other in order[1:]:
        apart = np.arccos(np.clip(np.abs(centres[other, 1] @ centres[best, 1]), 0, 1))
        if apart > max(0.17, 4 * error) and costs[other] < costs[best] + ALIKE:
            return Begun(_none(), waits="two motions explain the lines alike", **said)
    if abs(np.clip(ahead, -3, 3).sum()) < 0.3 * len(ahead):
        return Begun(_none(), waits="forwards and backwards explain the lines alike", **said)
    if error > SURE:
        return Begun(_none(), waits="the camera has moved too little", **said)
    if agree.mean() < LEAST_AGREEMENT:
        return Begun(_none(), waits=f"{agree.mean():.0%} of the lines agree on the best motion", **said)
    poses = []
    known = _Map.of(seen, turns[best, 1], centres[best, 1])
    for k, frame in enumerate(frames):
        if k == 0:
            pose = np.eye(3), np.zeros(3)
        elif k == len(frames) - 1:
            pose = turns[best, 1], centres[best, 1]
        elif k == middle:
            pose = turns[best, 0], centres[best, 0]
        elif (pose := known.locate(_View.of(frame))) is None:
            return Begun(_none(), waits=f"frame {k} sees too few of the lines", **said)
        poses.append(np.column_stack(pose))
    return Begun(np.stack(poses), **said)


def _adjusted(seen: _Seen, motions: list[_Motion]) -> tuple[Array, Array, Array, Array]:
    """Levenberg and Marquardt's method with Cauchy weights on (B, ...) motions at once: them, costs, covariances."""
    turns, centres = np.stack([m.turns for m in motions]), np.stack([m.centres for m in motions])
    damping, cost = np.full(len(turns), 1e-3), _costs(*seen.residuals(turns, centres))
    for step_index in range(STEPS + 1):
        hessian, gradient = _equations(seen, turns, centres)
        if step_index == STEPS:
            break
        damped = hessian + damping[:, None, None] * (np.eye(12) * np.diagonal(hessian, 0, 1, 2)[:, None]) + 1e-6 * np.eye(12)
        moved = _moved(turns, centres, -np.linalg.solve(damped, gradient[..., None])[:, None, :, 0])
        turned, shifted = moved[0][:, 0], moved[1][:, 0]
        shifted /= np.linalg.norm(shifted[:, 1:], axis=2, keepdims=True)
        now = _costs(*seen.residuals(turned, shifted))
        better = now < cost
        turns[better], centres[better], cost[better] = turned[better], shifted[better], now[better]
        damping = np.where(better, 0.2 * damping, 20 * damping)
    return turns, centres, cost, np.linalg.inv(hessian + 1e-6 * np.eye(12))


def _equations(seen: _Seen, turns: Array, centres: Array) -> tuple[Array, Array]:
    """(B, 12, 12) and (B, 12): of rotations after the motions' and shifts of the centres; the scale stays."""
    step = 1e-6
    many = _moved(turns, centres, step * np.concatenate([np.zeros((1, 12)), np.eye(12)])[None])
    lines, points = seen.residuals(*(values.reshape(-1, *values.shape[2:]) for values in many))
    lines, points = (r.reshape(len(turns), 13, *r.shape[1:]) for r in (lines, points))
    weights = 1 / np.sqrt(1 + (lines[:, :1] ** 2).sum(axis=2, keepdims=True) / ROBUST), 1 / np.sqrt(1 + points[:, :1] ** 2 / ROBUST)
    rows = np.concatenate([(r * w).reshape(len(turns), 13, -1) for r, w in zip((lines, points), weights, strict=True)], axis=2)
    slopes = (rows[:, 1:] - rows[:, :1]) / step
    scale = np.concatenate([np.zeros((len(turns), 6)), centres.reshape(-1, 6)], axis=1)
    hessian = slopes @ slopes.swapaxes(1, 2) + 1e6 * scale[:, :, None] * scale[:, None]
    return hessian, (slopes @ rows[:, 0, :, None])[..., 0]


def _moved(turns: Array, centres: Array, change: Array) -> tuple[Array, Array]:
    """(B, C, ...) motions (B, ...) after changes (B or 1, C, 12): Cayley's turns, and shifts."""
    change = change.reshape(*change.shape[:2], 4, 3)
    skew = np.cross(np.eye(3), change[:, :, :2, None] / 2)
    turned = turns[:, None] @ np.linalg.solve(np.eye(3) + skew, np.eye(3) - skew)
    return turned, centres[:, None] + change[:, :, 2:]


def _costs(lines: Array, points: Array) -> Array:
    """(B,)"""
    return ROBUST * (np.log1p((lines**2).sum(axis=1) / ROBUST).sum(axis=1) + np.log1p(points**2 / ROBUST).sum(axis=(1, 2)))


def _turned(first: _View, second: _View) -> tuple[Array, float]:
    """(3, 3) the rotation that explains most lines and points of two views, and the share that it does not."""
    ids, points = _common([first.ids, second.ids]), _common([first.point_ids, second.point_ids])
    one, two = (np.searchsorted(view.ids, ids) for view in (first, second))
    p, q = (view.points[np.searchsorted(view.point_ids, points)] for view in (first, second))
    rays = [np.concatenate([v.normals[rows], x]) for v, rows, x in ((first, one, p), (second, two, q))]
    here, there = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rays)
    middle, by_first = first.ends[0, one], first.across[0][:, one]
    weights = np.ones(len(here))
    for _ in range(6):
        u, _, v = np.linalg.svd((here * weights[:, None]).T @ there)
        turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
        off = (second.normals[two] @ turn.T * middle).sum(axis=1)
        by_second = (second.errors[:, two] @ turn.T * middle).sum(axis=2)
        lines = off**2 / ((by_first**2).sum(axis=0) + (by_second**2).sum(axis=0))
        apart = np.linalg.norm(here - there @ turn.T, axis=1)[len(ids) :] * first.focal / POINT_ERROR
        squares = np.concatenate([lines, apart**2 / 2])
        weights = 1 / (1 + squares / ROBUST)
    return turn, float((squares > 9).mean()) if len(squares) else 0.0


def _candidates(seen: _Seen) -> list[_Motion]:
    motions = []
    for by, rows, least in (("points", slice(0, seen.flow), 8), ("corners", slice(seen.flow, None), 6)):
        for seed in range(1):
            last = _essential(seen.rays[0, rows], seen.rays[2, rows], seen.views[0].focal, seed, least)
            if last is not None and (middle := _Map.of(seen, *last).locate(seen.views[1])) is not None:
                motions.append(_Motion(np.stack([middle[0], last[0]]), np.stack([middle[1], last[1]]), by))
    turns = _vanishing(seen.views)
    if turns is not None and (centres := _centres(seen, turns)) is not None:
        motions.append(_Motion(turns, centres, "vanishing directions"))
    return motions


def _essential(here: Array, there: Array, focal: float, seed: int, least: int) -> tuple[Array, Array] | None:
    if len(here) < least:
        return None
    options = {"max_epipolar_error": 1.5 / focal, "min_iterations": 100, "max_iterations": 1000, "seed": seed}
    pose, report = poselib.estimate_relative_pose(here[:, :2], there[:, :2], _IDEAL, _IDEAL, options, {})
    if report["num_inliers"] < least:
        return None
    turn, centre = _of(pose)
    return turn, centre / np.linalg.norm(centre)


def _inverse_depths(seen: _Seen, turn: Array, centre: Array) -> tuple[Array, Array]:
    """Inverse depths in the first view of both ends of the lines (2, N) and of the points (M,), and their deviations."""
    first, _, last = seen.views
    ends = _both(first.ends)
    plane, errors = last.normals @ turn.T, last.errors @ turn.T
    base = plane @ centre
    base = np.where(np.abs(base) < TINY, TINY, base)
    depths = (ends * plane).sum(axis=2) / base
    by_last = np.einsum("enc,knc->ekn", errors, ends) - depths * (errors @ centre)[:, None]
    by_first = (plane * first.normals * (1, 1, 0)).sum(axis=1) * _both(first.across).swapaxes(0, 1)
    sigmas = np.sqrt((by_last**2).sum(axis=0) + (by_first**2).sum(axis=0)) / np.abs(base)
    u, v, x = seen.rays[0] @ turn, -centre @ turn, seen.rays[2]
    a, b = x[:, :2] * u[:, 2:] - u[:, :2], v[:2] - x[:, :2] * v[2]
    square = (b**2).sum(axis=1) + TINY
    of_points = (a * b).sum(axis=1) / square
    return depths, sigmas, of_points, np.sqrt(2 / square) * seen.sigmas * np.abs(u[:, 2])


@dataclass(frozen=True)
class _Map:
    """Lines and points in space by first and last view: ids (N,), ends (2, N, 3), point ids (P,), points (P, 3)."""

    ids: Ids
    ends: Array
    point_ids: Ids
    points: Array
    focal: float

    @staticmethod
    def of(seen: _Seen, turn: Array, centre: Array) -> _Map:
        depths, sigmas, of_points, point_sigmas = _inverse_depths(seen, turn, centre)
        first = seen.views[0]
        lines, points = (depths > 3 * sigmas).all(axis=0), (of_points > 3 * point_sigmas)[: seen.flow]
        ends = _both(first.ends[:, lines]) / depths[:, lines, None]
        space = first.points[points] / of_points[: seen.flow][points, None]
        return _Map(first.ids[lines], ends, first.point_ids[points], space, first.focal)

    def locate(self, view: _View) -> tuple[Array, Array] | None:
        """The pose of a view by PoseLib."""
        _, mine, lines = np.intersect1d(self.ids, view.ids, assume_unique=True, return_indices=True)
        _, own, points = np.intersect1d(self.point_ids, view.point_ids, assume_unique=True, return_indices=True)
        if len(mine) + len(own) < 6:
            return None
        observed = _both(view.ends[:, lines])[..., :2]
        pose, report = poselib.estimate_absolute_pose_pnpl(
            view.points[points, :2], self.points[own], *observed, *self.ends[:, mine], _IDEAL,
            {"max_reproj_error": 2 / self.focal, "min_iterations": 30, "max_iterations": 300, "seed": 0},
            {"loss_type": "HUBER", "loss_scale": 0.5 / self.focal},
        )  # fmt: skip
        return _of(pose) if report["num_inliers"] >= 6 else None


def _both(ends: Array) -> Array:
    """(2, N, 3) both ends of lines by their middles and halves."""
    return np.stack([ends[0] - ends[1], ends[0] + ends[1]])


def _vanishing(views: list[_View]) -> Array | None:
    """(2, 3, 3) rotations of middle and last view, by two vanishing directions that the same lines have in all views."""
    n = np.stack([view.normals / np.linalg.norm(view.normals, axis=1, keepdims=True) for view in views])
    i, j = np.triu_indices(n.shape[1], 1)
    if len(i) > 1500:
        pick = np.random.default_rng(0).permutation(len(i))[:1500]
        i, j = i[pick], j[pick]
    d = np.cross(n[:, i], n[:, j])
    size = np.linalg.norm(d, axis=2)
    d = d[:, size.min(axis=0) > PARALLEL] / size[:, size.min(axis=0) > PARALLEL, None]
    found = []
    free = np.ones(n.shape[1], np.bool_)
    for _ in range(2):
        if not d.shape[1]:
            return None
        belongs = (np.abs(d @ n.swapaxes(1, 2)) < PARALLEL).all(axis=0) & free
        rows = belongs[belongs.sum(axis=1).argmax()]
        if rows.sum() < 3:
            return None
        axes = np.linalg.svd(n[:, rows], full_matrices=False)[2][:, 2]
        found.append(axes * np.where((axes[0] * axes).sum(axis=1) < 0, -1, 1)[:, None])
        free &= ~rows
        d = d[:, np.abs(d[0] @ axes[0]) < 0.87]
    (a, b) = found
    frames = np.stack([a, b, np.cross(a, b)], axis=1)
    u, _, v = np.linalg.svd(frames[0].T @ frames[1:])
    return u @ (np.array([1, 1, 0])[:, None] * np.eye(3) + np.linalg.det(u @ v)[:, None, None] * np.diag([0, 0, 1])) @ v


def _centres(seen: _Seen, turns: Array) -> Array | None:
    """(2, 3) the centres by linear least squares, all rotations being known."""
    n = [seen.views[0].normals, *(seen.views[k].normals @ turns[k - 1].T for k in (1, 2))]
    n = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in n]
    by_first, by_last = np.cross(n[1], n[0])[:, :, None] * n[2][:, None], np.cross(n[1], n[2])[:, :, None] * n[0][:, None]
    rows = [np.concatenate([by_first - by_last, -by_first], axis=2).reshape(-1, 6)]
    r = [seen.rays[0], *(seen.rays[k] @ turns[k - 1].T for k in (1, 2))]
    none = np.zeros_like(r[0])
    rows += [np.hstack(pair) for pair in ((np.cross(r[0], r[1]), none), (none, np.cross(r[0], r[2])), (-np.cross(r[1], r[2]), np.cross(r[1], r[2])))]
    A = np.concatenate(rows)
    weights = np.ones(len(A))
    for _ in range(6):
        centres = np.linalg.svd(A * weights[:, None], full_matrices=False)[2][-1].reshape(2, 3)
        off = np.abs(A @ centres.ravel())
        weights = 1 / np.sqrt(off + np.median(off) + TINY)
    size = np.linalg.norm(centres[1])
    return centres / size if size > 1e-3 else None


def _corners(views: list[_View]) -> Array:
    """(3, C, 3) where lines meet that have an end nearby in all three views."""
    n = np.stack([view.normals for view in views])
    i, j = np.triu_indices(n.shape[1], 1)
    meeting = np.cross(n[:, i], n[:, j])
    near = (np.abs(meeting[..., 2]) > LEAST_SINE).all(axis=0)
    i, j, meeting = i[near], j[near], meeting[:, near]
    meeting = meeting / meeting[..., 2:]
    ends = np.stack([np.stack([v.ends[0] - v.ends[1], v.ends[0] + v.ends[1]], axis=1) for v in views])
    gaps = [np.linalg.norm(meeting[:, :, None] - ends[:, rows], axis=3).min(axis=2) for rows in (i, j)]
    return meeting[:, (np.maximum(*gaps) * views[0].focal < MEETING).all(axis=0)]


def _common(ids: list[Ids], most: int = 1 << 30) -> Ids:
    found = ids[0]
    for other in ids[1:]:
        found = np.intersect1d(found, other, assume_unique=True)
    return found[:: -(-len(found) // most)] if len(found) else found


def _rays(points: NDArray[np.floating]) -> Array:
    return np.concatenate([np.float64(points), np.ones((*points.shape[:-1], 1))], axis=-1)


def _of(pose: poselib.CameraPose) -> tuple[Array, Array]:
    turn = np.asarray(pose.R).T
    return turn, -turn @ np.asarray(pose.t)


def _none() -> Array:
    return np.zeros((0, 3, 4))

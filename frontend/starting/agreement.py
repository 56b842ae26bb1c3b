"""How well lines and points agree with where three cameras are said to be, and the motions nearby that they agree with.

No line in space is estimated. The planes that a line spans with the first and the last camera meet in a line, which
the middle camera must see where it saw it (Hartley and Zisserman 2004, 15.1): two equations. A point gives one for each
pair of views, the epipolar one. Both are divided by their standard deviations to first order, which follow from the
errors in the images (Sampson's approximation, 4.2.6): a line in one plane with all cameras tells and weighs nothing.

A motion is (2, 3, 4): poses of the middle and the last camera in the first one's axes, from first to last it is 1.
"""

from __future__ import annotations

import numpy as np

from frontend.starting.views import TINY, Array, Seen

STEPS = 8
ENOUGH = 0.01  # of the costs, by which a step must make one of them less
ROBUST = 2.0  # squared standard deviations: Cauchy's scale
DIFFERENCE = 1e-6  # radians, and shares of the motion


def residuals(seen: Seen, motions: Array) -> tuple[Array, Array]:
    """In standard deviations, (B, 2, N) of the lines and (B, 3, M) of the points under motions (B, 2, 3, 4)."""
    turns, centres = motions[..., :3], motions[..., 3:]
    first, middle, last = seen.views
    to_world = turns.swapaxes(2, 3)
    planes, plane_errors = last.normals @ to_world[:, 1], last.errors @ to_world[:, 1:]
    ends, back = middle.ends @ to_world[:, :1], centres[:, 0] - centres[:, 1]
    near, far = (first.normals @ centres[:, 0])[..., 0], (planes @ back)[..., 0]
    image = far[..., None] * first.normals - near[..., None] * planes  # of the line, in the middle view
    off = (ends * image[:, None]).sum(axis=3)
    on_first, on_last = (ends * first.normals).sum(axis=3)[:, None], (ends * planes[:, None]).sum(axis=3)[:, None]
    by_first = far[:, None, None] * np.einsum("benc,knc->bken", ends, first.errors)
    by_first -= on_last * (first.errors @ centres[:, :1]).swapaxes(2, 3)
    by_last = on_first * (plane_errors @ back[:, None]).swapaxes(2, 3) - near[:, None, None] * np.einsum(
        "benc,bknc->bken", ends, plane_errors
    )
    across = (image * (middle.normals * (1, 1, 0) @ to_world[:, 0])).sum(axis=2)
    by = np.concatenate([by_first, by_last, across[:, None, None] * middle.across], axis=1)
    xx, yy, xy = (by[:, :, 0] ** 2).sum(axis=1), (by[:, :, 1] ** 2).sum(axis=1), (by[:, :, 0] * by[:, :, 1]).sum(axis=1)
    x = off[:, 0] / np.sqrt(xx + TINY**2)
    y = (off[:, 1] - xy / (xx + TINY**2) * off[:, 0]) / np.sqrt(np.maximum(yy - xy**2 / (xx + TINY**2), 0) + TINY**2)

    poses = np.concatenate([np.broadcast_to(np.eye(3, 4), (len(motions), 1, 3, 4)), motions], axis=1)
    rays = seen.rays @ poses[..., :3].swapaxes(2, 3)
    points = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        skew = crossing(poses[:, j, :, 3] - poses[:, i, :, 3])
        by_i, by_j = rays[:, j] @ skew, rays[:, i] @ skew.swapaxes(1, 2)
        gap = (rays[:, i] * by_i).sum(axis=2)
        slopes = [(by @ poses[:, k, :, :2]) ** 2 for by, k in ((by_i, i), (by_j, j))]
        points.append(gap / (seen.sigmas * np.sqrt(slopes[0].sum(axis=2) + slopes[1].sum(axis=2) + TINY**2)))
    return np.stack([x, y], axis=1), np.stack(points, axis=1)


def costs(lines: Array, points: Array) -> Array:
    """(B,) of the residuals: squared standard deviations with Cauchy's loss, for each line and each pair of a point."""
    of_lines = np.log1p((lines**2).sum(axis=1) / ROBUST).sum(axis=1)
    return np.asarray(ROBUST * (of_lines + np.log1p(points**2 / ROBUST).sum(axis=(1, 2))))


def adjusted(seen: Seen, motions: Array, held: int = 0) -> tuple[Array, Array, Array]:
    """Levenberg and Marquardt's method on motions (B, 2, 3, 4) at once; of the first few the last centre is held.

    Returns:
        (B, 2, 3, 4) motions, (B,) their costs, (B, 3, 3) covariances of the last camera's centre.
    """
    motions, damping = motions.copy(), np.full((len(motions), 1), 1e-3)
    fixed = (np.arange(len(motions)) < held)[:, None, None] * np.diag(np.arange(12) >= 9) / DIFFERENCE
    cost = costs(*residuals(seen, motions))
    for _ in range(STEPS):
        hessian, gradient = _equations(seen, motions)
        damped = hessian + fixed + np.eye(12) * (damping * np.diagonal(hessian, 0, 1, 2) + DIFFERENCE)[:, None]
        step = np.asarray(np.linalg.solve(damped, gradient), np.float64)
        moved = _moved(motions, -step[:, None, :, 0])[:, 0]
        moved[..., 3] /= np.linalg.norm(moved[:, 1:, :, 3], axis=2, keepdims=True)
        now = costs(*residuals(seen, moved))
        better = now < cost
        gained = np.where(better, cost - now, 0).max()
        motions[better], cost[better] = moved[better], now[better]
        damping *= np.where(better, 0.2, 20)[:, None]
        if better.all() and gained < ENOUGH:
            break
    covariances = np.linalg.inv(_equations(seen, motions)[0] + DIFFERENCE * np.eye(12))
    return motions, cost, np.asarray(covariances[:, 9:, 9:], np.float64)


def _equations(seen: Seen, motions: Array) -> tuple[Array, Array]:
    """(B, 12, 12) and (B, 12, 1) of the changes in `_moved`, which must leave the scale alone."""
    many = _moved(motions, DIFFERENCE * np.vstack([np.zeros(12), np.eye(12)])[None])
    lines, points = (r.reshape(len(motions), 13, *r.shape[1:]) for r in residuals(seen, many.reshape(-1, 2, 3, 4)))
    lines = lines / np.sqrt(1 + (lines[:, :1] ** 2).sum(axis=2, keepdims=True) / ROBUST)
    points = points / np.sqrt(1 + points[:, :1] ** 2 / ROBUST)
    rows = np.concatenate([r.reshape(len(motions), 13, -1) for r in (lines, points)], axis=2)
    slopes = (rows[:, 1:] - rows[:, :1]) / DIFFERENCE
    scale = np.concatenate([np.zeros((len(motions), 6)), motions[..., 3].reshape(-1, 6)], axis=1)[..., None]
    return slopes @ slopes.swapaxes(1, 2) + scale * scale.swapaxes(1, 2) / DIFFERENCE, slopes @ rows[:, 0, :, None]


def _moved(motions: Array, change: Array) -> Array:
    """(B, C, 2, 3, 4) motions (B, ...) after changes (B or 1, C, 12): turns (Cayley's formula) and shifts."""
    change = change.reshape(*change.shape[:2], 4, 3)
    half = crossing(change[:, :, :2]) / 2
    turns = motions[:, None, ..., :3] @ np.linalg.solve(np.eye(3) + half, np.eye(3) - half)
    shifted = motions[:, None, ..., 3:] + change[:, :, 2:, :, None]
    return np.concatenate([turns, shifted], axis=-1)


def crossing(v: Array) -> Array:
    """(..., 3, 3) by which a row x is multiplied for x cross v (..., 3)."""
    return np.cross(np.eye(3), v[..., None, :])

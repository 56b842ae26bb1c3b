"""How the camera moved between two images, from points whose depth is more or less known.

A point (x, y) on the plane z = 1, at inverse depth r, is seen from the moved camera at the projection of R (x, y, 1) +
r t. Depths that are not known leave what lies across the epipolar lines, as in two-view geometry; those that are known
fix the length of t in their unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit

LEAST_POINTS, MOST_POINTS = 5, 160
STEPS = 10
MEDIAN_SQUARE = 1.386  # of a chi-square of two degrees of freedom
LEAST_DAMPING = 1e-6  # where the points say nothing of a turn, for one when all are in the same place
SMALLEST_STEP = 3e-5  # change of the motion, radians, at which they end
MAX_ERROR = 1.5  # of a motion that is believed
SHIFT = 0.06  # of a start, in depths of the scene
LONGEST = 0.5  # of a translation, in depths of the scene, standard deviation
LOOSE, TIGHT = 1.5, 2.0  # robust scale: times the median error, and at least so many standard deviations

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """The camera's motion: a point at X is at `rotation` X + `translation` afterwards.

    Attributes:
        rotation: (3, 3) float64.
        translation: (3,) float64, in the unit of depth.
        error: median distance of the points from where they should be, over its standard deviation; about 1.
    """

    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation: Array = field(default_factory=lambda: np.zeros(3))
    error: float = 1.0


def camera_motion(
    before: NDArray[np.float32],
    after: NDArray[np.float32],
    inverse_depths: NDArray[np.float32],
    depth_errors: NDArray[np.float32],
    noise: float,
    previous: Motion,
) -> Motion:
    """The motion that most points agree on: Levenberg and Marquardt's method with Cauchy weights.

    Args:
        before, after: (P, 2) float32 points on the plane z = 1.
        inverse_depths: (P,) float32 with (P,) standard deviations `depth_errors`.
        noise: standard deviation of `after`, on the plane.
        previous: where to start, unless no motion fits better; the answer where the points are too few.
    """
    if len(before) < LEAST_POINTS:
        return previous
    every = -(-len(before) // MOST_POINTS)
    some = [np.ascontiguousarray(values[::every]) for values in (before, after, inverse_depths, depth_errors)]
    points = *some, noise
    best = _align(*points, previous.rotation, previous.translation, 6)
    if best[2] > MAX_ERROR:  # a jerk, or the first two images: from the best turn alone, and from shifts along the axes
        turned, still, _, _ = _align(*points, np.eye(3), np.zeros(3), 3)
        shifts = (still, *(sign * SHIFT * axis for sign in (-1, 1) for axis in np.eye(3)))
        best = min((best, *(_align(*points, turned, shift, 6) for shift in shifts)), key=lambda found: found[3])
    return Motion(*best[:3])


@njit()
def _align(before, after, depths, errors, noise, R, T, free):  # type: ignore[no-untyped-def]
    """Levenberg and Marquardt's method on all, or on the first three, of six unknowns: motion, error, cost."""
    squares = np.empty(len(before), np.float64)
    damping, scale, cost = 1e-4, TIGHT * TIGHT, 0.0
    for step_index in range(STEPS):
        if step_index % 2 == 0:
            _cost(before, after, depths, errors, noise, R, T, scale, squares)
            scale = max(TIGHT * TIGHT, LOOSE * LOOSE * np.median(squares))
        cost = _cost(before, after, depths, errors, noise, R, T, scale, squares)
        a, b = np.zeros((6, 6), np.float64), np.zeros(6, np.float64)
        for n in range(len(before)):
            _add(before[n], after[n], depths[n], errors[n], noise, R, T, scale, a, b)
        for k in range(3):
            a[3 + k, 3 + k] += len(before) / (LONGEST * LONGEST)
            b[3 + k] -= T[k] * len(before) / (LONGEST * LONGEST)
        moved = False
        for _ in range(3):
            damped = a[:free, :free].copy()
            for k in range(free):
                damped[k, k] += damping * damped[k, k] + LEAST_DAMPING
            step = np.zeros(6, np.float64)
            step[:free] = np.linalg.solve(damped, b[:free])
            turned, shifted = _rotation(step[:3]) @ R, T + step[3:]
            now = _cost(before, after, depths, errors, noise, turned, shifted, scale, squares)
            if now < cost:
                R, T, cost, moved, damping = turned, shifted, now, True, 0.2 * damping
                break
            damping = max(20 * damping, 1e-2)
        if not moved or np.sqrt((step * step).sum()) < SMALLEST_STEP:
            break
    cost = _cost(before, after, depths, errors, noise, R, T, TIGHT * TIGHT, squares)
    return R, T, np.sqrt(np.median(squares) / MEDIAN_SQUARE), cost


@njit(inline="always")
def _seen(start, end, depth, error, noise, R, T):  # type: ignore[no-untyped-def]
    """A point as it is expected: turned without r t (3), r, its projection (2), its error (2), and information (3).

    The inverse depth r is the most likely one, after what is known of it and where the point is seen; the error is
    linearised there. The information is the inverse covariance of noise, and of the depth along the epipolar line.
    """
    x, y = start[0], start[1]
    tx = R[0, 0] * x + R[0, 1] * y + R[0, 2]
    ty = R[1, 0] * x + R[1, 1] * y + R[1, 2]
    tz = R[2, 0] * x + R[2, 1] * y + R[2, 2]
    r, n = depth, noise * noise
    px = py = gx = gy = 0.0
    for step in range(3):
        z = max(tz + r * T[2], 0.05)
        px, py = (tx + r * T[0]) / z, (ty + r * T[1]) / z
        gx, gy = (T[0] - px * T[2]) / z, (T[1] - py * T[2]) / z
        if step < 2:
            towards = gx * (end[0] - px) + gy * (end[1] - py) + (gx * gx + gy * gy) * (r - depth)
            r = depth + towards / (gx * gx + gy * gy + n / (error * error))
    dx, dy = end[0] - px + gx * (r - depth), end[1] - py + gy * (r - depth)
    gx, gy = gx * error, gy * error
    inner = (n + gx * gx + gy * gy) * n
    return tx, ty, tz, r, px, py, dx, dy, (n + gy * gy) / inner, -gx * gy / inner, (n + gx * gx) / inner


@njit()
def _cost(before, after, depths, errors, noise, R, T, scale, squares):  # type: ignore[no-untyped-def]
    """Negative log likelihood; `squares` are the points' squared distances over their covariances.

    Without the covariances' part a long translation would explain everything by depths that are not known.
    """
    total = 0.5 * (T * T).sum() / (LONGEST * LONGEST) * len(before)
    for k in range(len(before)):
        _, _, _, _, _, _, dx, dy, i00, i01, i11 = _seen(before[k], after[k], depths[k], errors[k], noise, R, T)
        squares[k] = i00 * dx * dx + 2 * i01 * dx * dy + i11 * dy * dy
        total += 0.5 * (scale * np.log(1 + squares[k] / scale) - np.log(noise**4 * (i00 * i11 - i01 * i01)))
    return total


@njit()
def _add(start, end, depth, error, noise, R, T, scale, a, b):  # type: ignore[no-untyped-def]
    """Add a point to the normal equations; the unknowns are a turn after R, and the change of T."""
    tx, ty, tz, r, px, py, dx, dy, i00, i01, i11 = _seen(start, end, depth, error, noise, R, T)
    weight = 1 / (1 + (i00 * dx * dx + 2 * i01 * dx * dy + i11 * dy * dy) / scale)
    z = max(tz + r * T[2], 0.05)
    jx = (-px * ty / z, (tz + px * tx) / z, -ty / z, r / z, 0.0, -px * r / z)
    jy = (-(tz + py * ty) / z, py * tx / z, tx / z, 0.0, r / z, -py * r / z)
    for row in range(6):
        ux, uy = weight * (i00 * jx[row] + i01 * jy[row]), weight * (i01 * jx[row] + i11 * jy[row])
        b[row] += ux * dx + uy * dy
        for column in range(6):
            a[row, column] += ux * jx[column] + uy * jy[column]


@njit()
def _rotation(v):  # type: ignore[no-untyped-def]
    """Rodrigues' formula."""
    angle = np.sqrt((v * v).sum())
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    if angle < 1e-12:
        return np.eye(3) + K
    return np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * (K @ K)

"""A track's line as a Kalman filter has it: where it is across itself at both ends, and how far away these are.

The state of a line is (d0, d1, r0, r1): the offsets of its ends across itself, px, and the inverse depths of the ends,
in the unit of the camera's motion. Inverse depth is linear along the image of a line in space, so ends may be moved
along the line at will. Where the camera moves, the line's motion across itself tells the depths; from then on a line
that is one in space is predicted to fractions of a pixel, and one that drifts onto its neighbour is noticed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from frontend.tracking.camera_motion import Motion

DEPTH, DEPTH_ERROR = 1.0, 1.0  # inverse depth of a new line, in that of the scene, and its standard deviation
UNSURE = 1.0  # px, of an end whose variance was lost
SLOPE = 2.0  # by how much inverse depth changes along a line as long as the focal length, in its own unit
STILL, MOVING, PER_PIXEL = 0.03, 0.09, 0.01  # px, error of a prediction: always, of a motion of 1 px, and per px
DEPTH_WALK = 0.01  # of inverse depth from frame to frame: what the motion's error makes of it
FLOW_GATE = 9.0  # squared error of flow over its variance, above which it shows something else

Float32 = NDArray[np.float32]
Array = NDArray[np.float64]


def new_covariances(segments: Float32, lines: Float32, focal: float) -> Float32:
    """(N, 4, 4) covariances of new states: (N, 2, 2) segments, px, with (N, 2, 2) covariances of offset and angle."""
    delta = segments[:, 1] - segments[:, 0]
    length = np.maximum(np.hypot(delta[:, 0], delta[:, 1]), 1.0)
    covariances = np.zeros((len(segments), 4, 4), np.float32)
    to_ends = np.ones((len(segments), 2, 2), np.float32)
    to_ends[:, 0, 1], to_ends[:, 1, 1] = -length / 2, length / 2
    covariances[:, :2, :2] = to_ends @ lines @ to_ends.transpose(0, 2, 1)
    apart = np.minimum(1.0, SLOPE * length / focal) ** 2 / 4
    covariances[:, 2:, 2:] = DEPTH_ERROR**2
    covariances[:, 2, 2] += apart
    covariances[:, 3, 3] += apart
    covariances[:, 2, 3] -= apart
    covariances[:, 3, 2] -= apart
    return covariances


def line_part(segments: Float32, covariances: Float32) -> Float32:
    """(N, 2, 2) covariances of offset at the middle, px, and angle, radians, of states with (N, 4, 4) covariances."""
    delta = segments[:, 1] - segments[:, 0]
    length = np.maximum(np.hypot(delta[:, 0], delta[:, 1]), 1.0)
    first, both, last = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    part = np.empty((len(segments), 2, 2), np.float32)  # the same number twice, which a product of matrices is not
    part[:, 0, 0], part[:, 1, 1] = (first + 2 * both + last) / 4, (first - 2 * both + last) / length**2
    part[:, 0, 1] = part[:, 1, 0] = (last - first) / (2 * length)
    return part


def predict(
    planes: Array,
    depths: Float32,
    covariances: Float32,
    places: Float32,
    flows: tuple[Array, Array, NDArray[np.bool_]],
    motion: Motion,
    focal: float,
    flow_noise: float,
) -> tuple[Array, Array, Array, Array]:
    """Move states with the camera, after flow of their own points has told more of their depths.

    Args:
        planes: (N, 2, 2) float64 ends on the plane z = 1.
        depths: (N, 2) inverse depths, and `covariances` (N, 4, 4).
        places: (N, 2) of the flow's points along the line, from 0 to 1.
        flows: (N, 2, 2) where they were and (N, 2, 2) are on the plane z = 1, and (N, 2) whether that is consistent.
        motion: the camera's; where it fits badly predictions err more.
        focal: px per unit of the plane.
        flow_noise: px, standard deviation of flow.

    Returns:
        All of the first three, moved, in float64, and (N,) how far the lines moved across themselves, px.
    """
    camera = motion.rotation, motion.translation, focal, flow_noise, max(1.0, motion.error)
    moved: tuple[Array, Array, Array, Array] = _predict(planes, *_doubles(depths, covariances, places), *flows, *camera)
    return moved


def innovations(
    segments: Float32, covariances: Float32, measured: Float32, noise: Float32
) -> tuple[Array, Array, Array, Array]:
    """How far measured lines lie from predicted ones, at the ends of these.

    Args:
        segments: (N, 2, 2) predicted, px, with covariances (N, 4, 4) of their states.
        measured: (N, 2, 2) px, in the same directions, with noise (N, 2, 2), covariances of offset and angle.

    Returns:
        (N, 2) offsets, px, their (N, 2, 2) covariances, (N,) squared and normalised: chi-square of two degrees of
        freedom where all is as it should be; and (N,) the larger distance of a measured end from the predicted line.
    """
    found: tuple[Array, Array, Array, Array] = _innovations(*_doubles(segments, covariances, measured, noise))
    return found


def update(
    segments: Float32, depths: Float32, covariances: Float32, offsets: Array, spread: Array
) -> tuple[Array, Array, Array]:
    """States after their measurements (Kalman 1960); `offsets` and `spread` as of `innovations`."""
    updated: tuple[Array, Array, Array] = _update(*_doubles(segments, depths, covariances), offsets, spread)
    return updated


def slide(segments: Array, depths: Array, covariances: Array, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """States whose ends lie at the places `low` and `high` (N,) along the lines, where 0 and 1 are the ends so far."""
    moved: tuple[Array, Array, Array] = _slide(segments, depths, covariances, low, high)
    return moved


def _doubles(*arrays: NDArray[Any]) -> list[Array]:
    return [np.ascontiguousarray(array, np.float64) for array in arrays]


@njit()
def _predict(planes, depths, covariances, places, starts, ends, known, R, T, focal, flow_noise, inflation):  # type: ignore[no-untyped-def]
    across = np.zeros(len(planes))
    planes, depths, covariances = planes.copy(), depths.copy(), covariances.copy()
    gain = np.empty(4, np.float64)
    F = np.eye(4)
    for n in range(len(planes)):
        P = covariances[n]
        for k in range(2):
            if not known[n, k]:
                continue
            nx, ny = _moved_normal(planes[n], depths[n], R, T)
            s = places[n, k]
            depth = (1 - s) * depths[n, 0] + s * depths[n, 1]
            px, py, gx, gy, _ = _moved(starts[n, k, 0], starts[n, k, 1], depth, R, T)
            error = focal * (nx * (ends[n, k, 0] - px) + ny * (ends[n, k, 1] - py))
            g = focal * (nx * gx + ny * gy)
            first, second = (1 - s) * g, s * g
            for row in range(4):
                gain[row] = P[row, 2] * first + P[row, 3] * second
            variance = flow_noise**2 + gain[2] * first + gain[3] * second
            if error * error > FLOW_GATE * variance:
                continue
            gain /= variance
            _shift(planes[n], gain[0] * error / focal, gain[1] * error / focal)
            depths[n, 0] += gain[2] * error
            depths[n, 1] += gain[3] * error
            for row in range(4):
                for column in range(4):
                    P[row, column] -= gain[row] * gain[column] * variance
        nx, ny = _moved_normal(planes[n], depths[n], R, T)
        motion = 0.0
        before = nx * (planes[n, 0, 0] + planes[n, 1, 0]) + ny * (planes[n, 0, 1] + planes[n, 1, 1])
        for k in range(2):
            x, y = planes[n, k, 0], planes[n, k, 1]
            px, py, gx, gy, z = _moved(x, y, depths[n, k], R, T)
            motion = max(motion, focal * np.hypot(px - x, py - y))
            planes[n, k, 0], planes[n, k, 1] = px, py
            depths[n, k] /= z
            F[k, k], F[k, 2 + k], F[2 + k, 2 + k] = 1 / z, focal * (nx * gx + ny * gy), 1 / z
        after = nx * (planes[n, 0, 0] + planes[n, 1, 0]) + ny * (planes[n, 0, 1] + planes[n, 1, 1])
        across[n] = 0.5 * focal * abs(after - before)
        _congruence(F, P)
        for k in range(2):
            P[k, k] += (inflation * (STILL + MOVING * min(1.0, motion) + PER_PIXEL * motion)) ** 2
            P[2 + k, 2 + k] += (inflation * DEPTH_WALK) ** 2
    return planes, depths, covariances, across


@njit(inline="always")
def _moved(x, y, depth, R, T):  # type: ignore[no-untyped-def]
    """A point of the plane z = 1 from the moved camera: x, y, their derivatives by inverse depth, and z."""
    z = max(R[2, 0] * x + R[2, 1] * y + R[2, 2] + depth * T[2], 0.1)
    px = (R[0, 0] * x + R[0, 1] * y + R[0, 2] + depth * T[0]) / z
    py = (R[1, 0] * x + R[1, 1] * y + R[1, 2] + depth * T[1]) / z
    return px, py, (T[0] - px * T[2]) / z, (T[1] - py * T[2]) / z, z


@njit(inline="always")
def _moved_normal(plane, depth, R, T):  # type: ignore[no-untyped-def]
    x0, y0, _, _, _ = _moved(plane[0, 0], plane[0, 1], depth[0], R, T)
    x1, y1, _, _, _ = _moved(plane[1, 0], plane[1, 1], depth[1], R, T)
    length = max(np.hypot(x1 - x0, y1 - y0), 1e-9)
    return -(y1 - y0) / length, (x1 - x0) / length


@njit(inline="always")
def _shift(segment, first, second):  # type: ignore[no-untyped-def]
    """Move the ends of a segment across it."""
    dx, dy = segment[1, 0] - segment[0, 0], segment[1, 1] - segment[0, 1]
    length = max(np.hypot(dx, dy), 1e-9)
    nx, ny = -dy / length, dx / length
    segment[0, 0] += first * nx
    segment[0, 1] += first * ny
    segment[1, 0] += second * nx
    segment[1, 1] += second * ny


@njit()
def _innovations(segments, covariances, measured, noise):  # type: ignore[no-untyped-def]
    offsets, spread = np.zeros((len(segments), 2)), np.zeros((len(segments), 2, 2))
    squares, away = np.zeros(len(segments)), np.zeros(len(segments))
    for n in range(len(segments)):
        p, m = segments[n], measured[n]
        px, py = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1]
        length = max(np.hypot(px, py), 1e-6)
        nx, ny = -py / length, px / length
        dx, dy = m[1, 0] - m[0, 0], m[1, 1] - m[0, 1]
        across = max(np.hypot(dx, dy), 1e-6)
        ux, uy = dx / across, dy / across
        cx, cy = 0.5 * (m[0, 0] + m[1, 0]), 0.5 * (m[0, 1] + m[1, 1])
        cosine = max(ux * ny - uy * nx, 0.2)
        t0 = t1 = 0.0
        for k in range(2):
            away[n] = max(away[n], abs(nx * (m[k, 0] - p[0, 0]) + ny * (m[k, 1] - p[0, 1])))
            x, y = cx - p[k, 0], cy - p[k, 1]
            offsets[n, k] = (-uy * x + ux * y) / cosine
            along = -(x * ux + y * uy)
            if k == 0:
                t0 = along
            else:
                t1 = along
        c00, c01, c11 = noise[n, 0, 0], noise[n, 0, 1], noise[n, 1, 1]
        s00 = covariances[n, 0, 0] + c00 + 2 * t0 * c01 + t0 * t0 * c11
        s01 = covariances[n, 0, 1] + c00 + (t0 + t1) * c01 + t0 * t1 * c11
        s11 = covariances[n, 1, 1] + c00 + 2 * t1 * c01 + t1 * t1 * c11
        spread[n, 0, 0], spread[n, 0, 1], spread[n, 1, 0], spread[n, 1, 1] = s00, s01, s01, s11
        e0, e1 = offsets[n]
        squares[n] = (s11 * e0 * e0 - 2 * s01 * e0 * e1 + s00 * e1 * e1) / (s00 * s11 - s01 * s01)
    return offsets, spread, squares, away


@njit()
def _update(segments, depths, covariances, offsets, spread):  # type: ignore[no-untyped-def]
    segments, depths, covariances = segments.copy(), depths.copy(), covariances.copy()
    K, moved = np.empty((4, 2), np.float64), np.empty(4, np.float64)
    for n in range(len(segments)):
        P = covariances[n]
        s00, s01, s11 = spread[n, 0, 0], spread[n, 0, 1], spread[n, 1, 1]
        det = s00 * s11 - s01 * s01
        e0, e1 = offsets[n, 0], offsets[n, 1]
        for row in range(4):
            K[row, 0] = (P[row, 0] * s11 - P[row, 1] * s01) / det
            K[row, 1] = (P[row, 1] * s00 - P[row, 0] * s01) / det
            moved[row] = K[row, 0] * e0 + K[row, 1] * e1
        _shift(segments[n], moved[0], moved[1])
        depths[n, 0] += moved[2]
        depths[n, 1] += moved[3]
        for row in range(4):
            for column in range(row + 1):
                first, second = K[column, 0] * s00 + K[column, 1] * s01, K[column, 0] * s01 + K[column, 1] * s11
                P[row, column] -= K[row, 0] * first + K[row, 1] * second
                P[column, row] = P[row, column]
    return segments, depths, covariances


@njit(inline="always")
def _congruence(A, P):  # type: ignore[no-untyped-def]
    """P becomes A P A^T; small matrices, for which BLAS would take longer."""
    half = np.empty((4, 4), np.float64)
    for row in range(4):
        for column in range(4):
            half[row, column] = 0.0
            for k in range(4):
                half[row, column] += A[row, k] * P[k, column]
    for row in range(4):
        for column in range(4):
            P[row, column] = 0.0
            for k in range(4):
                P[row, column] += half[row, k] * A[column, k]


@njit()
def _slide(segments, depths, covariances, low, high):  # type: ignore[no-untyped-def]
    segments, depths, covariances = segments.copy(), depths.copy(), covariances.copy()
    M = np.zeros((4, 4))
    for n in range(len(segments)):
        a, b = low[n], high[n]
        for block in range(2):
            M[2 * block, 2 * block], M[2 * block, 2 * block + 1] = 1 - a, a
            M[2 * block + 1, 2 * block], M[2 * block + 1, 2 * block + 1] = 1 - b, b
        for axis in range(2):
            first, last = segments[n, 0, axis], segments[n, 1, axis]
            segments[n, 0, axis], segments[n, 1, axis] = (1 - a) * first + a * last, (1 - b) * first + b * last
        first, last = depths[n, 0], depths[n, 1]
        depths[n, 0], depths[n, 1] = (1 - a) * first + a * last, (1 - b) * first + b * last
        _congruence(M, covariances[n])
        _keep_positive(covariances[n])
    return segments, depths, covariances


@njit(inline="always")
def _keep_positive(P):  # type: ignore[no-untyped-def]
    """Of ends that lay far outside of the image, rounding is larger than what is left when they come back."""
    for k in range(4):
        if not P[k, k] > 0:
            P[k, k] = UNSURE**2 if k < 2 else DEPTH_ERROR**2
    for row in range(4):
        for column in range(row):
            most = (1 - 1e-6) * np.sqrt(P[row, row] * P[column, column])
            P[row, column] = P[column, row] = min(max(P[row, column], -most), most)

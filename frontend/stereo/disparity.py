"""What two views of a line in a rectified pair tell: disparities of its end points, and where these are in space.

A line with the unit direction u, moved by e across itself (to where y follows x), is moved by -e / u_y along a row. A
line's errors are an offset o across at its middle and an angle a, so at t px along from there e = o + t a. With the
left line's end point (x, y) and the right line's x' in the same row, the disparity is x - x' and its error

    (o' + t' a') / u'_y - (o + t a) / u_y

Two views of one edge have the same texture beside it and the same bias: the right line errs as the left one does, and
by something of its own on top, the difference of their covariances. At infinity the disparity is
`CameraModel.disparity_offset`; Z = fx baseline / (disparity - offset).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.camera.model import CameraModel

MIN_SINE = 0.2  # of the angle between a line and the rows, below which its ends tell no disparity
MIN_ERROR, MAX_ERROR = 0.001, 0.8  # px, standard deviations of disparities that are believed and tell a depth,
MIN_RATIO = 3.0  # and how many of them it is away from infinity
OWN = 0.3  # of the variances of a detected line, that its partner's errors do not share

Float32 = NDArray[np.float32]
Array = NDArray[np.float64]

_quiet = np.errstate(all="ignore")  # NaN and infinities are answers here


@_quiet
def disparities(
    left: Float32, left_covariances: Float32, right: Float32, right_covariances: Float32, offset: float
) -> tuple[Float32, Float32, NDArray[np.bool_]]:
    """Disparities of the left lines' end points, their errors, and whether they tell depths.

    Args:
        left, right: (N, 2, 2) px, in the same directions; NaN where there is no right line.
        left_covariances, right_covariances: (N, 2, 2) of (offset at the middle, px; angle, radians); the latter are
            the former and what the right lines err on their own.
        offset: disparity of points at infinity, px.

    Returns:
        (N, 2) float32 px, NaN for lines along the rows; their (N, 2, 2) float32 covariances, px^2; and the (N,) mask
        of those that are known within 0.8 px and beyond doubt (three standard deviations) from infinity, at both ends.
    """
    ours, theirs = _along_rows(left, left[..., 1]), _along_rows(right, left[..., 1])
    disparity = left[..., 0] - theirs[0] + 0 * ours[1]  # NaN where the left line runs along the rows
    jacobian, errors = _jacobian(ours, theirs), _both(left_covariances, right_covariances)
    to_disparity = jacobian[:, :2] - jacobian[:, 2:]
    covariances = to_disparity @ errors @ to_disparity.transpose(0, 2, 1)
    spread = np.sqrt(np.einsum("nkk->nk", covariances))
    known = ((spread >= MIN_ERROR) & (spread <= MAX_ERROR) & (disparity - offset > MIN_RATIO * spread)).all(
        axis=1
    )  # false for NaN
    return disparity.astype(np.float32), covariances.astype(np.float32), known


@_quiet
def detection_errors(left: Float32, left_covariances: Float32, right: Float32, right_covariances: Float32) -> Array:
    """(N, 2, 2) px^2, covariances of disparities of the left ends if both lines were detected, each on its own.

    Args:
        left, right: as of `disparities`.
        left_covariances, right_covariances: (N, 2, 2) of each, most of which both have in common.
    """
    jacobian = _jacobian(_along_rows(left, left[..., 1]), _along_rows(right, left[..., 1]))
    ours, theirs = jacobian[:, :2, :2], jacobian[:, 2:, 2:]
    errors = ours @ left_covariances @ ours.transpose(0, 2, 1) + theirs @ right_covariances @ theirs.transpose(0, 2, 1)
    return np.asarray(OWN * errors)


@_quiet
def own_covariances(left: Float32, right: Float32, errors: Array) -> Float32:
    """(N, 2, 2) float32 covariances that right lines have on top of the left ones', for errors of disparities.

    Args:
        left, right: as of `disparities`.
        errors: (N, 2, 2) px^2, covariances of the disparities of the left ends.
    """
    jacobian = _jacobian(_along_rows(left, left[..., 1]), _along_rows(right, left[..., 1]))
    inverse = np.linalg.inv(jacobian[:, 2:, 2:])
    return (inverse @ errors @ inverse.transpose(0, 2, 1)).astype(np.float32)


@_quiet
def in_metres(
    left: Float32,
    left_covariances: Float32,
    right: Float32,
    right_covariances: Float32,
    known: NDArray[np.bool_],
    camera: CameraModel,
) -> tuple[Float32, Float32]:
    """End points in space, in the left camera's frame.

    Args:
        left, left_covariances, right, right_covariances: as of `disparities`.
        known: (N,) mask of the lines with depth; the others are NaN.
        camera: of the rectified pair.

    Returns:
        (N, 2, 3) float32 m, and the (N, 6, 6) float32 covariances of their errors, m^2. The place along the line is
        none of the errors, so the rank is 4.
    """
    ours, theirs = _along_rows(left, left[..., 1]), _along_rows(right, left[..., 1])
    rays = np.concatenate([np.float64(camera.normalize(left)), np.ones((len(left), 2, 1))], axis=2)
    shift = np.where(known[:, None], left[..., 0] - theirs[0] - camera.disparity_offset, np.nan)
    depth = camera.fx * camera.baseline_m / shift
    points = rays * depth[..., None]
    by_right = points / shift[..., None]  # of both ends, per px along the row
    by_left = np.array([1 / camera.fx, 0, 0]) * depth[..., None] - by_right
    ends = np.zeros((len(left), 2, 3, 4))
    for end in range(2):
        ends[:, end, :, end], ends[:, end, :, 2 + end] = by_left[:, end], by_right[:, end]
    jacobian = ends.reshape(-1, 6, 4) @ _jacobian(ours, theirs)
    covariances = jacobian @ _both(left_covariances, right_covariances) @ jacobian.transpose(0, 2, 1)
    return points.astype(np.float32), ((covariances + covariances.transpose(0, 2, 1)) / 2).astype(np.float32)


def _along_rows(lines: Float32, rows: NDArray[np.floating]) -> tuple[Array, Array, Array]:
    """(N, 2) x of lines in some rows, (N, 2) how far along from their middles that is, and (N,) their u_y.

    NaN for lines along the rows.
    """
    lines = np.asarray(lines, np.float64)
    delta, middle = lines[:, 1] - lines[:, 0], lines.mean(axis=1)
    u = delta / np.hypot(delta[:, 0], delta[:, 1])[:, None]
    slope = np.where(np.abs(u[:, 1]) >= MIN_SINE, u[:, 1], np.nan)
    along = (np.float64(rows) - middle[:, 1:]) / slope[:, None]
    return middle[:, :1] + along * u[:, :1], along, slope


def _jacobian(left: tuple[Array, Array, Array], right: tuple[Array, Array, Array]) -> Array:
    """(N, 4, 4): how left x, left x', right x, right x' move along the rows with o, a of the left and right line."""
    jacobian = np.zeros((len(left[2]), 4, 4))
    for row, (_, along, slope) in ((0, left), (2, right)):
        for end in range(2):
            jacobian[:, row + end, row] = -1 / slope
            jacobian[:, row + end, row + 1] = -along[:, end] / slope
    return jacobian


def _both(left: Float32, right: Float32) -> Array:
    """(N, 4, 4) covariances of two views of a line, of which the right one errs as the left one, and more."""
    return np.asarray(np.block([[left, left], [left, right]]), np.float64)

"""How far observed lines are from the images of lines in space, with derivatives.

The image of the line through A and B, in the camera's axes, is l = A x B: the moment of its Pluecker coordinates about
the camera. An observed point q on the plane z = 1 is q . l / |(l_0, l_1)| away from it. Sum and difference of these
distances at both observed ends are the offset and the angle of which the frontend tells the variances, so the residual
needs no depth to be positive and holds nothing along the line.
"""

from __future__ import annotations

import numpy as np

from line_odometry.views import TINY, Array, Lines


def line_errors(lines: Lines, a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Of lines through a and b (N, 3), in the axes of the camera that observed N lines.

    Returns:
        (N, 2) whitened errors of offset and angle, their (N, 2, 3) derivatives by l, and (N, 3) l.
    """
    images = np.cross(a, b)
    size = np.hypot(images[:, 0], images[:, 1])[:, None] + TINY
    first, last = np.moveaxis(np.concatenate([lines.ends, np.ones((len(a), 2, 1))], axis=2), 1, 0)
    length = np.linalg.norm(last - first, axis=1, keepdims=True)
    probes = np.stack([(first + last) / 2, (last - first) / length], axis=1) / np.sqrt(lines.variances)[:, :, None]
    errors = (probes @ images[:, :, None])[:, :, 0] / size
    by_image = probes / size[:, :, None]
    by_image[:, :, :2] -= errors[:, :, None] * (images[:, None, :2] / size[:, None] ** 2)
    return errors, by_image, images


def end_errors(lines: Lines, errors: Array) -> Array:
    """(N, 2) distances of the observed ends, on the plane z = 1, of which (N, 2) whitened errors are made."""
    middle, angle = (errors * np.sqrt(lines.variances)).T
    half = np.linalg.norm(lines.ends[:, 1] - lines.ends[:, 0], axis=1) / 2
    return np.stack([middle - half * angle, middle + half * angle], axis=1)

"""Lines on the plane z = 1, and how sure they are there.

A line from q_0 to q_1, with the unit vector d = (d_u, d_v) between them, is a u + b v + c = 0 with the normal
(a, b) = n = (-d_v, d_u) and c = -n . (q_0 + q_1) / 2: the left side is a point's signed distance from the line. Its
errors are, as in pixels, an offset along n at the middle and an angle, radians.

A line of length L in pixels that errs by (offset, angle) errs at its ends by offset -+ angle L / 2 across. A small step
across at end k, per pixel, moves q_k by s_k across the line on the plane, which is l long there. So to first order

    offset' = s offset + t angle L / 2       angle' = (2 t offset + s angle L) / l
    s = (s_1 + s_0) / 2                      t = (s_1 - s_0) / 2
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_quiet = np.errstate(all="ignore")  # infinities and NaN are answers here


@_quiet
def normals(segments: NDArray[np.floating]) -> NDArray[np.float64]:
    """(N, 2) unit vectors across (N, 2, 2) segments, to where y follows x; NaN for those without length."""
    delta = np.float64(segments[:, 1]) - segments[:, 0]
    return np.asarray(np.stack([-delta[:, 1], delta[:, 0]], axis=1) / np.hypot(delta[:, 0], delta[:, 1])[:, None])


@_quiet
def coefficients(ends: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, 3) float32 a, b and c of the lines through (N, 2, 2) end points on the plane; NaN as `normals`."""
    n = normals(ends)
    return np.column_stack([n, -(n * ends.mean(axis=1, dtype=np.float64)).sum(axis=1)]).astype(np.float32)


@_quiet
def covariances_on_plane(
    segments: NDArray[np.float32],
    covariances: NDArray[np.float32],
    ends: NDArray[np.float32],
    steps: NDArray[np.floating],
) -> NDArray[np.float32]:
    """Covariances of lines whose ends went through a lens.

    Args:
        segments: (N, 2, 2) px.
        covariances: (N, 2, 2) of (offset at the middle, px; angle, radians).
        ends: (N, 2, 2) where the ends are on the plane.
        steps: (N, 2, 2) how far they move there for a pixel along the `normals` of the segments.

    Returns:
        (N, 2, 2) float32 of (offset at the middle of `ends`; angle, radians).
    """
    s_0, s_1 = (steps * normals(ends)[:, None]).sum(axis=2).T
    length, there = (np.hypot(*(np.float64(one[:, 1]) - one[:, 0]).T) for one in (segments, ends))
    s, t = (s_1 + s_0) / 2, (s_1 - s_0) / 2
    rows = np.array([[s, t * length / 2], [2 * t / there, s * length / there]]).transpose(2, 0, 1)
    turned = rows @ covariances @ rows.transpose(0, 2, 1)
    return np.asarray((turned + turned.transpose(0, 2, 1)) / 2, np.float32)  # symmetric to the last bit

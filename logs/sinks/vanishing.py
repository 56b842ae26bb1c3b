"""Where lines in space that are parallel meet in the image: what UV-SLAM takes with each line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEAST = 6  # lines that make a vanishing point: fewer meet by chance
LEAST_SHARE = 0.08  # of all lines, as many as which do so too
LONGEST = 40  # of them are intersected
TOLERANCE = np.sin(np.radians(1.0))  # UV-SLAM's own
FLATTEST = 1e-3  # z of a unit direction that is to be written as x, y, 1; UV-SLAM's own is 1.1e-3


def vanishing_points(lines: NDArray[np.float32]) -> NDArray[np.float32]:
    """The vanishing point of each line, by a vote; the directions need not be at right angles.

    Each intersection of two of the longest lines gets the lengths of the lines whose middle sees it along the line, to
    within 1 degree, and beyond the line's ends. The best is taken with its lines, moved to where these meet best, and
    the rest votes again. The threshold on the number of lines keeps chance out, and corners where three or four meet.

    Args:
        lines: (K, 2, 2) end points, undistorted, on the plane z = 1.

    Returns:
        (K, 3) float32 x, y, 1; zeros for a line that has none.
    """
    found = np.zeros((len(lines), 3), np.float32)
    ends = np.asarray(lines, np.float64)
    middles, halves = ends.mean(1), (ends[:, 1] - ends[:, 0]) / 2
    lengths = np.linalg.norm(halves, axis=1)
    planes = np.cross(*np.insert(ends, 2, 1.0, axis=2).swapaxes(0, 1))
    planes /= np.maximum(np.linalg.norm(planes, axis=1, keepdims=True), 1e-12)
    longest = np.argsort(-lengths)[:LONGEST]
    first, second = np.triu_indices(len(longest), 1)
    points = np.cross(planes[longest[first]], planes[longest[second]])
    points = points[np.linalg.norm(points, axis=1) > 1e-6]
    left = lengths > 0

    def voters(points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(M, K) which lines point to which of (M, 3) points."""
        towards = points[:, None, :2] - points[:, None, 2:] * middles
        distance = np.linalg.norm(towards, axis=2)
        across = np.abs(towards[..., 0] * halves[:, 1] - towards[..., 1] * halves[:, 0])
        outside = distance > np.abs(points[:, 2:]) * lengths
        mask: NDArray[np.bool_] = outside & (across <= TOLERANCE * lengths * distance)
        return mask

    votes = voters(points)
    while len(points):
        best = votes[np.argmax((votes & left) @ lengths)] & left
        if best.sum() < max(LEAST, LEAST_SHARE * len(lines)):
            break
        point = np.linalg.svd(planes[best] * lengths[best, None], full_matrices=False)[2][-1]
        best |= voters(point[None])[0] & left
        z = np.copysign(max(abs(point[2]), FLATTEST), point[2])
        found[best] = *(point[:2] / z), 1.0
        left &= ~best
    return found

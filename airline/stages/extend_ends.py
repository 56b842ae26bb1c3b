"""End points, moved to where the edge ends (rows as in `airline.stages.split_regions`)."""

from __future__ import annotations

import numpy as np

from airline.kernels.compiled import njit
from airline.kernels.sampling import into_image
from airline.stages.score_parts import bilinear, room_for_samples, strength

FALL = 0.8  # px beyond its end where a ridge has fallen to half its height: 0.5 if binary, 1 if Gaussian
STEP = 0.5  # px
SHARE = 0.25  # of a line's length that each end may move on: what a short line adds is mostly chance


@njit()
def extend_ends(moments, owner, support, max_reach, start, end):  # type: ignore[no-untyped-def]
    """Move the end points of the surviving parts among `start` to `end` to where the edge map falls to half the line's
    mean.

    Args:
        moments: (P, 10) float64 parts, whose end points are changed.
        owner: (P,) int64 the part that each became one with.
        support: (H, W) float32 edge map.
        max_reach: px.
    """
    height, width = support.shape
    room = room_for_samples(support)
    for i in range(start, end):
        dx, dy = moments[i, 8] - moments[i, 6], moments[i, 9] - moments[i, 7]
        length = np.hypot(dx, dy)
        if owner[i] != i or max_reach <= 0 or length < 4:
            continue
        dx, dy = dx / length, dy / length
        farthest = min(max_reach, SHARE * length) + FALL
        level = 0.5 * strength(support, moments[i, 6], moments[i, 7], moments[i, 8], moments[i, 9], room)
        for side in range(2):
            x, y = moments[i, 6 + 2 * side], moments[i, 7 + 2 * side]
            ux, uy = (dx, dy) if side else (-dx, -dy)
            t = -1.5
            while t < farthest and bilinear(support, x + (t + STEP) * ux, y + (t + STEP) * uy) > level:
                t += STEP
            t -= FALL
            moments[i, 6 + 2 * side] = into_image(x + t * ux, width)
            moments[i, 7 + 2 * side] = into_image(y + t * uy, height)

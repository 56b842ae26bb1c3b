"""Where a line ends, and how sure it is: by the strength of the edge map along it (rows as in `split_regions`)."""

from __future__ import annotations

import numpy as np

from airline.kernels.compiled import njit
from airline.kernels.sampling import into_image, place_samples, sum_samples

FALL = 0.8  # px beyond its end where a ridge has fallen to half its height: 0.5 if binary, 1 if Gaussian
STEP = 0.5  # px
SHARE = 0.25  # of a line's length that each end may move on: what a short line adds is mostly chance
SHORT = 10.0  # px, the length at which a line of full strength scores 1/2


@njit()
def line_scores(support, ends):  # type: ignore[no-untyped-def]
    """(N,) float32 scores in [0, 1] of lines with end points (N, 4), px; see `line_score`."""
    scores = np.empty(len(ends), np.float32)
    room = room_for_samples(support)
    for i in range(len(ends)):
        scores[i] = line_score(support, ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3], room)
    return scores


@njit()
def score_parts(moments, owner, support, scores, start, end):  # type: ignore[no-untyped-def]
    """Set the scores, (P,) float32, of the surviving parts among `start` to `end`; arguments as of `extend_ends`."""
    room = room_for_samples(support)
    for i in range(start, end):
        if owner[i] == i:
            scores[i] = line_score(support, moments[i, 6], moments[i, 7], moments[i, 8], moments[i, 9], room)


@njit()
def line_score(support, x0, y0, x1, y1, room):  # type: ignore[no-untyped-def]
    """Score of one line, `mean strength * length / (length + SHORT)`: strength alone trusts short lines too much."""
    length = np.hypot(x1 - x0, y1 - y0)
    return np.float32(min(1.0, strength(support, x0, y0, x1, y1, room) * length / (length + SHORT)))


@njit()
def room_for_samples(support):  # type: ignore[no-untyped-def]
    """What `strength` needs: the (H * W,) map, and arrays for `airline.kernels.sampling` that hold any line."""
    height, width = support.shape
    most = int(np.hypot(width, height)) + 2
    return support.reshape(height * width), np.empty(most, np.int32), np.empty(2 * most, np.float32)


@njit()
def strength(support, x0, y0, x1, y1, room):  # type: ignore[no-untyped-def]
    """Mean of the map along a line, sampled about every pixel."""
    height, width = support.shape
    samples = max(2, int(np.hypot(x1 - x0, y1 - y0)))
    dx, dy = (x1 - x0) / (samples - 1), (y1 - y0) / (samples - 1)
    inside = min(x0, x1, y0, y1) >= -0.5 and max(x0, x1) <= width - 0.5 and max(y0, y1) <= height - 0.5
    if inside and min(height, width) > 1:
        values, places, work = room
        x, y = np.float32(x0), np.float32(y0)
        place_samples(width, height, x, y, np.float32(dx), np.float32(dy), 0, samples, places, work)
        return sum_samples(values, width, 0, samples, places, work) / samples
    total = 0.0
    for k in range(samples):
        total += bilinear(support, x0 + k * dx, y0 + k * dy)
    return total / samples


@njit()
def bilinear(image, x, y):  # type: ignore[no-untyped-def]
    """Value between pixels; 0 more than half a pixel outside the image."""
    height, width = image.shape
    if x < -0.5 or y < -0.5 or x > width - 0.5 or y > height - 0.5:
        return 0.0
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    column, row = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    fx, fy = x - column, y - row
    right, below = min(column + 1, width - 1), min(row + 1, height - 1)
    top = (1 - fx) * image[row, column] + fx * image[row, right]
    return (1 - fy) * top + fy * ((1 - fx) * image[below, column] + fx * image[below, right])


@njit()
def extend_ends(moments, owner, support, max_reach, start, end):  # type: ignore[no-untyped-def]
    """Move the end points of the surviving parts among `start` to `end` to where the map falls to half the line's mean.

    `moments` are (P, 10) float64, `owner` (P,) int64 (see `join_collinear`), `support` (H, W) float32, `max_reach` px.
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

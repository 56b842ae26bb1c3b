"""Which parts of the scene's lines the camera sees: exact hidden-line removal, then a check of contrast.

A point X (camera coordinates) is hidden by the face with M = [u v origin] where (a, b, c) = M^-1 X has 0 < a < c,
0 < b < c (its ray meets the face) and c > 1 (it lies behind). All are linear along a line, so the hidden part of a line
is one interval per face, found by clipping; no depth buffer and no sampling is involved.
"""

from __future__ import annotations

import numpy as np

from airline.kernels.compiled import njit
from airline.scenes.builder import Array
from airline.scenes.raster import NEAR

BEHIND = 2e-3  # m behind a face before it hides: a line lies on its own faces
MIN_LENGTH = 12.0  # px
SIDE = 1.5  # px from the line at which its two sides are compared
MERGE = 1.5  # px: closer parallel lines are one line to any observer


def pipe_outlines(pipes: Array, radii: Array, centre: Array) -> Array:
    """(C, 2, 2, 3) float64: per pipe the two lines where rays from `centre` (3,) graze it (NaN from inside)."""
    axis = pipes[:, 1] - pipes[:, 0]
    axis /= np.sqrt(np.sum(axis**2, axis=1, keepdims=True))
    away = centre - pipes[:, 0]
    away -= np.sum(away * axis, axis=1, keepdims=True) * axis
    distance = np.sqrt(np.sum(away * away, axis=1, keepdims=True))
    away /= distance
    cosine = radii[:, None] / distance
    with np.errstate(invalid="ignore"):
        across = np.sqrt(1 - cosine * cosine) * np.cross(axis, away)
    offset = radii[:, None, None] * np.stack([cosine * away - across, cosine * away + across], axis=1)
    return np.asarray(pipes[:, None] + offset[:, :, None])


@njit()
def _clip(low, high, at0, at1):  # type: ignore[no-untyped-def]
    """The part of [low, high] where the linear function from at0 (t = 0) to at1 (t = 1) is positive."""
    if at0 < 0 and at1 < 0:
        return 1.0, 0.0
    if at0 < 0:
        low = max(low, at0 / (at0 - at1))
    elif at1 < 0:
        high = min(high, at0 / (at0 - at1))
    return low, high


@njit()
def _pixels_long(a, b, focal):  # type: ignore[no-untyped-def]
    return np.hypot(a[0] / a[2] - b[0] / b[2], a[1] / a[2] - b[1] / b[2]) * focal


@njit()
def clip_to_view(lines, focal, cx, cy, width, height):  # type: ignore[no-untyped-def]
    """Cut (N, 2, 3) lines in camera coordinates (NaN: none) to what lies before the camera and inside the image.

    Returns (M,) int64 rows of `lines` and (M, 2, 3) float64 points.
    """
    rows = np.empty(len(lines), np.int64)
    points = np.empty((len(lines), 2, 3))
    found = 0
    for n in range(len(lines)):
        p, q = lines[n, 0], lines[n, 1]
        if not (np.isfinite(p[0]) and (p[2] > NEAR or q[2] > NEAR)):
            continue
        low, high = _clip(0.0, 1.0, p[2] - NEAR, q[2] - NEAR)
        low, high = _clip(low, high, focal * p[0] + cx * p[2], focal * q[0] + cx * q[2])
        low, high = _clip(low, high, (width - 1 - cx) * p[2] - focal * p[0], (width - 1 - cx) * q[2] - focal * q[0])
        low, high = _clip(low, high, focal * p[1] + cy * p[2], focal * q[1] + cy * q[2])
        low, high = _clip(low, high, (height - 1 - cy) * p[2] - focal * p[1], (height - 1 - cy) * q[2] - focal * q[1])
        if low >= high:
            continue
        a, b = points[found, 0], points[found, 1]
        a[:] = p + low * (q - p)
        b[:] = p + high * (q - p)
        if _pixels_long(a, b, focal) >= MIN_LENGTH:
            rows[found] = n
            found += 1
    return rows[:found].copy(), points[:found].copy()


@njit()
def remove_hidden(points, inverse, bounds, depths, focal, cx, cy):  # type: ignore[no-untyped-def]
    """(K,) int64 rows of (M, 2, 3) `points` and (K, 2, 3) pieces that no face of `raster.project_faces` hides."""
    capacity = 4 * len(points) + 16
    rows = np.empty(capacity, np.int64)
    pieces = np.empty((capacity, 2, 3))
    found = 0
    hidden = np.empty((len(inverse), 2))
    margin = np.empty(len(inverse))
    start_at, end_at = np.empty(3), np.empty(3)
    for f in range(len(inverse)):
        # The third row of M^-1 is the plane's normal over its distance: its length turns metres into shares of that.
        margin[f] = 1 + BEHIND * np.sqrt(np.sum(inverse[f, 2] ** 2))
    for n in range(len(points)):
        p, q = points[n, 0], points[n, 1]
        px, py = focal * p[0] / p[2] + cx, focal * p[1] / p[2] + cy
        qx, qy = focal * q[0] / q[2] + cx, focal * q[1] / q[2] + cy
        x0, x1, y0, y1, far = min(px, qx), max(px, qx), min(py, qy), max(py, qy), max(p[2], q[2])
        count = 0
        for f in range(len(inverse)):
            if x1 < bounds[f, 0] or x0 > bounds[f, 2] or y1 < bounds[f, 1] or y0 > bounds[f, 3] or far < depths[f]:
                continue
            for k in range(3):
                m = inverse[f, k]
                start_at[k] = m[0] * p[0] + m[1] * p[1] + m[2] * p[2]
                end_at[k] = m[0] * q[0] + m[1] * q[1] + m[2] * q[2]
            low, high = _clip(0.0, 1.0, start_at[2] - margin[f], end_at[2] - margin[f])
            for k in range(2):
                low, high = _clip(low, high, start_at[k], end_at[k])
            for k in range(2):
                low, high = _clip(low, high, start_at[2] - start_at[k], end_at[2] - end_at[k])
            if high - low > 1e-9:
                hidden[count, 0], hidden[count, 1] = low, high
                count += 1
        order = np.argsort(hidden[:count, 0])
        reached = 0.0
        for k in range(count + 1):
            start = hidden[order[k], 0] if k < count else 1.0
            if start > reached and found < capacity:
                a, b = p + reached * (q - p), p + start * (q - p)
                if _pixels_long(a, b, focal) >= MIN_LENGTH:
                    rows[found] = n
                    pieces[found, 0], pieces[found, 1] = a, b
                    found += 1
            if k < count:
                reached = max(reached, hidden[order[k], 1])
    return rows[:found].copy(), pieces[:found].copy()


@njit()
def _grey_at(grey, x, y):  # type: ignore[no-untyped-def]
    height, width = grey.shape
    x, y = min(max(x, 0.0), width - 1.001), min(max(y, 0.0), height - 1.001)
    x0, y0 = int(x), int(y)
    ax, ay = x - x0, y - y0
    upper = grey[y0, x0] * (1 - ax) + grey[y0, x0 + 1] * ax
    lower = grey[y0 + 1, x0] * (1 - ax) + grey[y0 + 1, x0 + 1] * ax
    return upper * (1 - ay) + lower * ay


@njit()
def keep_contrast(rows, pieces, grey, minimum, focal, cx, cy):  # type: ignore[no-untyped-def]
    """The runs of the pieces whose two sides differ by at least `minimum` grey levels in the clean image.

    The difference is averaged over 7 px along the line, and gaps of up to `gap` px are bridged. A run that ends within
    `gap` px of its piece takes the piece's end.
    """
    gap = 6
    capacity = 4 * len(pieces) + 16
    kept_rows = np.empty(capacity, np.int64)
    kept = np.empty((capacity, 2, 3))
    found = 0
    length_limit = int(np.hypot(grey.shape[0], grey.shape[1])) + 4
    step = np.empty(length_limit)
    for n in range(len(pieces)):
        p, q = pieces[n, 0], pieces[n, 1]
        x0, y0 = focal * p[0] / p[2] + cx, focal * p[1] / p[2] + cy
        dx, dy = focal * q[0] / q[2] + cx - x0, focal * q[1] / q[2] + cy - y0
        length = np.hypot(dx, dy)
        count = min(int(length) + 1, length_limit)
        dx, dy = dx / length, dy / length
        for k in range(count):
            x, y = x0 + k * dx, y0 + k * dy
            step[k] = _grey_at(grey, x - SIDE * dy, y + SIDE * dx) - _grey_at(grey, x + SIDE * dy, y - SIDE * dx)
        start, last = -1, -1
        for k in range(count + gap + 2):
            visible = False
            if k < count:
                low, high = max(0, k - 3), min(count, k + 4)
                visible = abs(np.mean(step[low:high])) >= minimum
            if visible:
                if start < 0:
                    start = k
                last = k
            elif start >= 0 and (k - last > gap or k >= count):
                begin = 0.0 if start <= gap else float(start)
                end = length if count - last <= gap else float(last)
                if end - begin >= MIN_LENGTH and found < capacity:
                    kept_rows[found] = rows[n]
                    for side in range(2):
                        s = (begin, end)[side] / length
                        t = s * p[2] / (s * p[2] + (1 - s) * q[2])
                        kept[found, side] = p + t * (q - p)
                    found += 1
                start = -1
    return kept_rows[:found].copy(), kept[:found].copy()


@njit()
def drop_doubles(pixels):  # type: ignore[no-untyped-def]
    """(N,) bool: False for a segment, px, that runs within MERGE px of a longer kept one for over half its length."""
    delta = pixels[:, 1] - pixels[:, 0]
    length = np.sqrt(delta[:, 0] ** 2 + delta[:, 1] ** 2)
    order = np.argsort(-length)
    keep = np.ones(len(pixels), np.bool_)
    for j in range(len(order)):
        n = order[j]
        for i in range(j):
            m = order[i]
            if not keep[m]:
                continue
            ux, uy = delta[m, 0] / length[m], delta[m, 1] / length[m]
            ax, ay = pixels[n, 0, 0] - pixels[m, 0, 0], pixels[n, 0, 1] - pixels[m, 0, 1]
            bx, by = pixels[n, 1, 0] - pixels[m, 0, 0], pixels[n, 1, 1] - pixels[m, 0, 1]
            if abs(ax * uy - ay * ux) > MERGE or abs(bx * uy - by * ux) > MERGE:
                continue
            s, t = ax * ux + ay * uy, bx * ux + by * uy
            shared = min(max(s, t), length[m]) - max(min(s, t), 0.0)
            if shared > 0.5 * abs(t - s):
                keep[n] = False
                break
    return keep

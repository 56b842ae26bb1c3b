"""How well lines of the right image fit those of the left one: where they are, and what is on both sides of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from frontend.stereo.disparity import MIN_SINE
from frontend.tracking.overlap import LineFeatures

MIN_COS = np.cos(np.deg2rad(25.0))  # of the angle between two views of a line
MIN_AGREEMENT = 0.5  # of their descriptors
MIN_APPEARANCE = 0.0  # and of their profiles
MIN_OVERLAP = 0.5  # of the shorter one
ROW_ERROR = 2.5  # px that a line along the rows may lie above or below its partner
ACROSS = np.array([-9.0, -6.0, -3.5, -1.5, 1.5, 3.5, 6.0, 9.0])  # px from the line
STATIONS = 6  # along it
FLOOR = 6.0  # grey levels: less contrast than this says little
ALIKE = 10.0  # grey levels of mean difference, that take away two thirds of a vote

Float32 = NDArray[np.float32]
Array = NDArray[np.float64]


def partner_votes(
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    lines: tuple[LineFeatures, LineFeatures],
    ranges: Array,
    gain: tuple[float, float],
) -> tuple[Float32, Float32]:
    """Votes of every left line for every right one that may be its partner.

    The rows that both have in common tell the disparities there; for lines along the rows the end points do. A vote is
    how alike the grey levels around both are then (correlation and difference), how much they overlap, and how well
    their descriptors agree.

    Args:
        images: (H, W) left and right one.
        lines: N left ones and M right ones.
        ranges: (N, 2) px, least and most disparity.
        gain: by which right grey levels become left ones, and what is added.

    Returns:
        (N, M) float32 votes, 0 for no partner, and (N, M, 2) float32 px disparities at both ends of what they have in
        common, in the direction of the left line.
    """
    left, right = lines
    shape = len(left.segments), len(right.segments)
    votes, found = np.zeros(shape, np.float32), np.zeros((*shape, 2), np.float32)
    each = [(np.ascontiguousarray(one.segments, np.float64), one.descriptors, one.profiles) for one in lines]
    _vote(*images, *each[0], *each[1], ranges, *gain, votes, found)
    return votes, found


@njit()
def _vote(  # type: ignore[no-untyped-def]  # shapes and dtypes as in `LineFeatures` and `partner_votes`
    image,
    other_image,
    segments,
    descriptors,
    profiles,
    others,
    other_descriptors,
    other_profiles,
    ranges,
    gain,
    lift,
    votes,
    found,
):
    work = np.empty((2, len(ACROSS), STATIONS))
    turned, place = np.empty((2, 2)), np.empty(4)
    units, tops, bottoms = _units_and_rows(others)
    for i in range(len(segments)):
        p = segments[i]
        dx, dy = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1]
        length = max(np.hypot(dx, dy), 1e-6)
        dx, dy = dx / length, dy / length
        top, bottom = min(p[0, 1], p[1, 1]) - ROW_ERROR, max(p[0, 1], p[1, 1]) + ROW_ERROR
        for j in range(len(others)):
            cosine = dx * units[j, 0] + dy * units[j, 1]
            if tops[j] > bottom or bottoms[j] < top or abs(cosine) < MIN_COS:
                continue
            slope, other_slope = abs(dy), abs(units[j, 1])
            steep = min(slope, other_slope) >= MIN_SINE
            if not steep and max(slope, other_slope) >= 2 * MIN_SINE:
                continue
            q = others[j]
            turned[0], turned[1] = (q[0], q[1]) if cosine > 0 else (q[1], q[0])
            agreement = np.float32(-1)
            for hypothesis in range(1 if steep else 3):
                overlap = _by_rows(p, turned, place) if steep else _by_ends(p, turned, hypothesis, place)
                low, high = min(place[2], place[3]), max(place[2], place[3])
                if overlap <= 0 or low < ranges[i, 0] or high > ranges[i, 1]:
                    continue
                if agreement < 0:
                    agreement = np.float32(0)
                    for k in range(descriptors.shape[1]):
                        agreement += descriptors[i, k] * other_descriptors[j, k]
                    appearance, last = np.float32(0), profiles.shape[1] - 1
                    for k in range(last + 1):
                        appearance += profiles[i, k] * other_profiles[j, k if cosine > 0 else last - k]
                    if appearance < MIN_APPEARANCE:
                        agreement = np.float32(0)
                if agreement < MIN_AGREEMENT:
                    break
                vote = overlap**0.25 * agreement
                if vote > votes[i, j]:
                    vote *= _alike(image, other_image, p, place, -dy, dx, gain, lift, work)
                if vote > votes[i, j]:
                    votes[i, j], found[i, j, 0], found[i, j, 1] = vote, place[2], place[3]


@njit()
def _units_and_rows(lines):  # type: ignore[no-untyped-def]
    """(M, 2) directions of lines, and (M,) their first and last rows."""
    units, tops, bottoms = np.empty((len(lines), 2)), np.empty(len(lines)), np.empty(len(lines))
    for j in range(len(lines)):
        dx, dy = lines[j, 1, 0] - lines[j, 0, 0], lines[j, 1, 1] - lines[j, 0, 1]
        length = max(np.hypot(dx, dy), 1e-6)
        units[j, 0], units[j, 1] = dx / length, dy / length
        tops[j], bottoms[j] = min(lines[j, 0, 1], lines[j, 1, 1]), max(lines[j, 0, 1], lines[j, 1, 1])
    return units, tops, bottoms


@njit(inline="always")
def _overlap(low, high, first, second):  # type: ignore[no-untyped-def]
    """Product of the shares of two lines, of which they have `high - low` in common; 0 if too little."""
    shared = (high - low) / max(min(first, second), 1e-6)
    return shared * (high - low) / max(first, second) if shared >= MIN_OVERLAP else 0.0


@njit()
def _by_rows(p, q, place):  # type: ignore[no-untyped-def]
    """From where to where along p it has rows in common with q, and the disparities there; returns the overlap."""
    dy, ey = p[1, 1] - p[0, 1], q[1, 1] - q[0, 1]
    if dy * ey <= 0:
        return 0.0
    low, high = max(0.0, (q[0, 1] - p[0, 1]) / dy), min(1.0, (q[1, 1] - p[0, 1]) / dy)
    slope = (q[1, 0] - q[0, 0]) / ey
    place[0], place[1] = low, high
    for k in range(2):
        x, y = p[0, 0] + place[k] * (p[1, 0] - p[0, 0]), p[0, 1] + place[k] * dy
        place[2 + k] = x - q[0, 0] - slope * (y - q[0, 1])
    return _overlap(low * abs(dy), high * abs(dy), abs(dy), abs(ey))


@njit()
def _by_ends(p, q, hypothesis, place):  # type: ignore[no-untyped-def]
    """The same of lines along the rows, if their first ends (0), last ends (1), or both (2) are the same points."""
    first, last = p[0, 0] - q[0, 0], p[1, 0] - q[1, 0]
    at_first, at_last = last if hypothesis == 1 else first, first if hypothesis == 0 else last
    a, b = p[0, 0] - at_first, p[1, 0] - at_last
    slope = (q[1, 1] - q[0, 1]) / (q[1, 0] - q[0, 0])  # they run along the rows
    if max(abs(q[0, 1] + slope * (a - q[0, 0]) - p[0, 1]), abs(q[0, 1] + slope * (b - q[0, 0]) - p[1, 1])) > ROW_ERROR:
        return 0.0
    if (b - a) * (q[1, 0] - q[0, 0]) <= 0:
        return 0.0
    low, high = max(0.0, (q[0, 0] - a) / (b - a)), min(1.0, (q[1, 0] - a) / (b - a))
    place[0], place[1] = low, high
    place[2], place[3] = at_first + low * (at_last - at_first), at_first + high * (at_last - at_first)
    return _overlap(low * abs(b - a), high * abs(b - a), abs(b - a), abs(q[1, 0] - q[0, 0]))


@njit()
def _alike(image, other, p, place, nx, ny, gain, lift, work):  # type: ignore[no-untyped-def]
    """How alike two images are around what two lines have in common, in [0, 1]."""
    mean, other_mean, difference = 0.0, 0.0, 0.0
    count = len(ACROSS) * STATIONS
    for k in range(STATIONS):
        s = (k + 0.5) / STATIONS
        t = place[0] + s * (place[1] - place[0])
        x, y = p[0, 0] + t * (p[1, 0] - p[0, 0]), p[0, 1] + t * (p[1, 1] - p[0, 1])
        disparity = place[2] + s * (place[3] - place[2])
        for c in range(len(ACROSS)):
            px, py = x + ACROSS[c] * nx, y + ACROSS[c] * ny
            here, there = level(image, px, py), lift + gain * level(other, px - disparity, py)
            work[0, c, k], work[1, c, k] = here, there
            mean += here / count
            other_mean += there / count
            difference += abs(here - there) / count
    product, squares, other_squares = 0.0, FLOOR * FLOOR * count, FLOOR * FLOOR * count
    for c in range(len(ACROSS)):
        for k in range(STATIONS):
            here, there = work[0, c, k] - mean, work[1, c, k] - other_mean
            product += here * there
            squares += here * here
            other_squares += there * there
    correlation = product / np.sqrt(squares * other_squares)
    return np.sqrt(max(correlation, 0.0)) * np.exp(-difference / ALIKE)


@njit(inline="always")
def level(image, x, y):  # type: ignore[no-untyped-def]
    """Grey level between pixels, outside of the image as at its border."""
    x, y = min(max(x, 0.0), image.shape[1] - 1.001), min(max(y, 0.0), image.shape[0] - 1.001)
    column, row = np.uint64(x), np.uint64(y)
    fx, fy = x - np.float64(column), y - np.float64(row)
    one = np.uint64(1)
    top = image[row, column] + fx * (np.float64(image[row, column + one]) - image[row, column])
    low = image[row + one, column] + fx * (np.float64(image[row + one, column + one]) - image[row + one, column])
    return top + fy * (low - top)

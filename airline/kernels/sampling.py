"""Values between pixels, at many places along lines at once.

Each step is a loop over all places that touches few arrays and has no branch, so that it is compiled into vector
instructions; one place after the other takes three times as long. Between the steps, the pixels right above of the
samples wait in `places` (int32) and their fractions of a pixel in `work` (float32, twice as long: x, then y).
"""

from __future__ import annotations

import numpy as np

from airline.kernels.compiled import njit

ZERO, BYTE = np.float32(0), np.uint32(255)
FIRST, SECOND, THIRD = np.uint32(8), np.uint32(16), np.uint32(24)


@njit()
def blocks_of(image):  # type: ignore[no-untyped-def]
    """(H, W) uint8 image to (H * W) uint32, in each place the four pixels around the point right below of it.

    Its own grey level is in the lowest byte, then those of its neighbours to the right, below, and both. The last row
    and column hold nothing.
    """
    height, width = image.shape
    blocks = np.empty((height, width), np.uint32)
    for y in range(height - 1):
        here, below, out = image[y], image[y + 1], blocks[y]
        for x in range(width - 1):
            upper = np.uint32(here[x]) | (np.uint32(here[x + 1]) << FIRST)
            out[x] = upper | (np.uint32(below[x]) << SECOND) | (np.uint32(below[x + 1]) << THIRD)
    return blocks.reshape(height * width)


@njit(fastmath={"contract"})
def lay(width, height, x, y, dx, dy, first, count, places, work):  # type: ignore[no-untyped-def]
    """Put samples `first` to `first + count` at (x, y) + k (dx, dy), float32 px; what is outside moves to the border.

    The image must be two pixels wide and high at least.
    """
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    last_column, last_row = np.int32(width - 2), np.int32(height - 2)
    stride, second = np.int32(width), np.uint64(len(places))
    for k in range(count):
        t = np.float32(np.int32(k))
        px, py = x + t * dx, y + t * dy
        px, py = px if px > ZERO else ZERO, py if py > ZERO else ZERO  # what is no number becomes 0, too
        px, py = px if px < right else right, py if py < bottom else bottom
        column, row = min(np.int32(px), last_column), min(np.int32(py), last_row)
        place = np.uint64(first + k)
        work[place] = px - np.float32(column)
        work[second + place] = py - np.float32(row)
        places[place] = row * stride + column


@njit()
def blend(blocks, count, places, work):  # type: ignore[no-untyped-def]
    """Replace the first `count` samples' fractions in x by bilinearly interpolated grey levels."""
    for k in range(count):
        places[np.uint64(k)] = blocks[np.uint64(places[np.uint64(k)])]
    _blend(count, places, work)


@njit(fastmath={"contract"})
def _blend(count, places, work):  # type: ignore[no-untyped-def]
    second = np.uint64(len(places))
    for k in range(count):
        four, place = np.uint32(places[k]), np.uint64(k)
        left, right = _level(four & BYTE), _level((four >> FIRST) & BYTE)
        low, high = _level((four >> SECOND) & BYTE), _level(four >> THIRD)
        fx, fy = work[place], work[second + place]
        top = left + fx * (right - left)
        work[place] = top + fy * (low + fx * (high - low) - top)


@njit()
def total_of(values, width, first, count, places, work):  # type: ignore[no-untyped-def]
    """Sum of samples `first` to `first + count`, bilinearly interpolated, of an image as (H * W) values."""
    stride, second, one = np.uint64(width), np.uint64(len(places)), np.uint64(1)
    total = 0.0
    for k in range(first, first + count):
        place, above = np.uint64(k), np.uint64(places[np.uint64(k)])
        below = above + stride
        left, right = np.float32(values[above]), np.float32(values[above + one])
        low, high = np.float32(values[below]), np.float32(values[below + one])
        fx, fy = work[place], work[second + place]
        top = left + fx * (right - left)
        total += top + fy * (low + fx * (high - low) - top)
    return total


@njit()
def _level(byte):  # type: ignore[no-untyped-def]
    return np.float32(np.int32(byte))

"""Bilinear interpolation at many places along lines at once.

Each step is a loop over all samples without a branch, which compiles to SIMD instructions. Between the steps the
samples are in `places`, (S,) int32 index of the pixel to the upper left in the flat image, and in `work`, (2 S,)
float32 fractions of a pixel, all of x before those of y.
"""

from __future__ import annotations

import numpy as np

from airline.kernels.compiled import njit

ZERO, BYTE = np.float32(0), np.uint32(255)
FIRST, SECOND, THIRD = np.uint32(8), np.uint32(16), np.uint32(24)


@njit()
def pack_neighbours(image):  # type: ignore[no-untyped-def]
    """(H, W) uint8 image to (H * W,) uint32: each pixel in the lowest byte, then right, lower, lower right ones."""
    height, width = image.shape
    packed = np.empty((height, width), np.uint32)
    for y in range(height - 1):
        here, below, out = image[y], image[y + 1], packed[y]
        for x in range(width - 1):
            upper = np.uint32(here[x]) | (np.uint32(here[x + 1]) << FIRST)
            out[x] = upper | (np.uint32(below[x]) << SECOND) | (np.uint32(below[x + 1]) << THIRD)
    return packed.reshape(height * width)


@njit(fastmath={"contract"})
def place_samples(width, height, x, y, dx, dy, first, count, places, work):  # type: ignore[no-untyped-def]
    """Put samples `first` to `first + count` at (x, y) + k (dx, dy), float32 px, moved into the image."""
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
def interpolate(packed, count, places, work):  # type: ignore[no-untyped-def]
    """Replace the first `count` fractions in `work` by grey levels of an image of `pack_neighbours`."""
    for k in range(count):
        places[np.uint64(k)] = packed[np.uint64(places[np.uint64(k)])]
    _interpolate(count, places, work)


@njit(fastmath={"contract"})
def _interpolate(count, places, work):  # type: ignore[no-untyped-def]
    second = np.uint64(len(places))
    for k in range(count):
        four, place = np.uint32(places[k]), np.uint64(k)
        left, right = _level(four & BYTE), _level((four >> FIRST) & BYTE)
        low, high = _level((four >> SECOND) & BYTE), _level(four >> THIRD)
        fx, fy = work[place], work[second + place]
        top = left + fx * (right - left)
        work[place] = top + fy * (low + fx * (high - low) - top)


@njit()
def sum_samples(values, width, first, count, places, work):  # type: ignore[no-untyped-def]
    """Sum of samples `first` to `first + count` of an image as (H * W,) numbers of any kind."""
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


@njit(inline="always")
def into_image(place, side):  # type: ignore[no-untyped-def]
    """A coordinate, moved into an image of so many pixels, which reaches half a pixel beyond their centres."""
    return min(max(place, -0.5), side - 0.5)


@njit()
def _level(byte):  # type: ignore[no-untyped-def]
    return np.float32(np.int32(byte))

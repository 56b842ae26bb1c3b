"""The image as the edge network takes it, and its answer as an edge map: both in one pass over the pixels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.compiled import njit
from airline.image import Gray
from airline.spec import UNetSpec
from airline.team import ALONE, Team

ONE = np.float32(1)
HALF = np.float32(0.5)
UPPER, ROUND, LAST = np.uint32(16), np.uint32(0x7FFF), np.uint32(1)
# Lambert's continued fraction of tanh(t), nine terms: t * (A0 + A1 s + ...) / (A0 + B1 s + ...) with s = t * t; cut off
# where it reaches 1, it is 6e-6 off at most
A0, A1, A2, A3 = (np.float32(value) for value in (34459425, 4729725, 135135, 990))
B1, B2, B3, B4 = (np.float32(value) for value in (16216200, 945945, 13860, 45))
LIMIT = np.float32(6.28)
LEAST_ROWS = 32  # of the network's first level that are worth a thread

Codes = NDArray[np.uint16 | np.uint32]


def folded_size(spec: UNetSpec, height: int, width: int) -> tuple[int, int]:
    """Rows and columns of the network's first level for an image of a size, filled up to the network's stride."""
    rows, columns = (-(-side // spec.stride) * spec.stride // spec.unshuffle for side in (height, width))
    return rows, columns


def fold(gray: Gray, spec: UNetSpec, codes: type[np.uint16] | type[np.uint32] = np.uint32, team: Team = ALONE) -> Codes:
    """(1, h, w, C) input of the network: normalised pixels of each block as channels, and smoothed copies.

    The same as `airline.unet.normalise`, `pixel_unshuffle` and `UNet._smoothed` on an image whose last row and column
    are repeated up to the network's stride, with the channels last, as convolutions take them.

    Args:
        gray: the image.
        spec: shape of the network.
        codes: np.uint16 for the bits of bfloat16, np.uint32 for those of float32: numpy has no bfloat16.
        team: threads that share the work.
    """
    mean, deviation = (float(value[0, 0]) for value in cv2.meanStdDev(gray))
    side = spec.unshuffle
    rows, columns = folded_size(spec, *gray.shape)
    planes = np.empty((rows, columns, side * side + spec.smoothed), codes)
    middle = np.empty((rows, columns), np.float32)
    factor = np.float32(1 / max(deviation, 1.0))
    team.share(
        rows, LEAST_ROWS, lambda start, end: _fold(gray, np.float32(mean), factor, side, planes, middle, start, end)
    )
    for level in range(spec.smoothed):
        smooth = np.empty_like(middle)
        _box_mean(middle, level + 1, smooth)
        _put_twice(smooth, planes, side * side + level)
        middle = smooth
    return planes[None]


def unfold(logits: Codes, side: int, height: int, width: int, team: Team = ALONE) -> NDArray[np.float32]:
    """(height, width) float32 edge probability of (h, w, side * side) logits, in the codes of `fold`."""
    edges = np.empty((height, width), np.float32)
    team.share(height, side * LEAST_ROWS, lambda start, end: _unfold(logits, side, edges, start, end))
    return edges


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _fold(gray: Any, mean: Any, factor: Any, side: int, planes: Any, middle: Any, start: int, end: int) -> None:
    height, width = gray.shape
    columns = middle.shape[1]
    values = np.empty(side * columns, np.float32)
    codes = np.empty(side * columns, planes.dtype)
    share = ONE / np.float32(side * side)
    for y in range(start, end):
        total = middle[y]
        for x in range(columns):
            total[x] = 0
        for dy in range(side):
            line = gray[min(side * y + dy, height - 1)]
            for x in range(width):
                values[x] = (np.float32(line[x]) - mean) * factor
            for x in range(width, len(values)):
                values[x] = values[width - 1]
            _encode(values.view(np.uint32), codes)
            for dx in range(side):
                part, code, out = values[dx::side], codes[dx::side], planes[y, :, side * dy + dx]
                for x in range(columns):
                    total[x] += part[x] * share
                for x in range(columns):
                    out[x] = code[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _put_twice(image: Any, planes: Any, channel: int) -> None:
    """Double values into a channel."""
    values = np.empty(image.shape[1], np.float32)
    codes = np.empty(image.shape[1], planes.dtype)
    for y in range(len(image)):
        line, out = image[y], planes[y, :, channel]
        for x in range(len(values)):
            values[x] = line[x] + line[x]
        _encode(values.view(np.uint32), codes)
        for x in range(len(values)):
            out[x] = codes[x]


@njit(cache=True, nogil=True)
def _encode(bits: Any, codes: Any) -> None:
    """Bits of float32 numbers as codes; bfloat16 is their upper half, rounded to the nearest, ties to the even one."""
    if codes.itemsize == 2:
        for x in range(len(bits)):
            codes[x] = (bits[x] + ROUND + ((bits[x] >> UPPER) & LAST)) >> UPPER
    else:
        for x in range(len(bits)):
            codes[x] = bits[x]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _box_mean(image: Any, radius: int, out: Any) -> None:
    """Mean of the square around each pixel, as far as it lies in the image."""
    rows, columns = image.shape
    sums = np.zeros(columns + 2 * radius, np.float32)
    share = np.empty(columns, np.float32)
    for x in range(columns):
        share[x] = ONE / np.float32(min(x, radius) + min(columns - 1 - x, radius) + 1)
    middle = sums[radius : radius + columns]
    for y in range(rows):
        first, last = max(y - radius, 0), min(y + radius, rows - 1)
        for x in range(columns):
            middle[x] = 0
        for row in range(first, last + 1):
            line = image[row]
            for x in range(columns):
                middle[x] += line[x]
        target = out[y]
        for x in range(columns):
            target[x] = 0
        for shift in range(2 * radius + 1):
            moved = sums[shift : shift + columns]
            for x in range(columns):
                target[x] += moved[x]
        share_of_rows = ONE / np.float32(last - first + 1)
        for x in range(columns):
            target[x] *= share_of_rows * share[x]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _unfold(logits: Any, side: int, edges: Any, start: int, end: int) -> None:
    bits = np.empty(logits.shape[1], np.uint32)
    values = bits.view(np.float32)
    shift = UPPER if logits.itemsize == 2 else np.uint32(0)
    for y in range(start, end):
        out = edges[y]
        for dx in range(side):
            part, place = logits[y // side, :, (y % side) * side + dx], out[dx::side]
            for x in range(len(place)):
                bits[x] = np.uint32(part[x]) << shift
            for x in range(len(place)):
                t = HALF * values[x]
                t = LIMIT if t > LIMIT else (-LIMIT if t < -LIMIT else t)
                s = t * t
                over = A0 + s * (A1 + s * (A2 + s * (A3 + s)))
                values[x] = HALF + HALF * t * over / (A0 + s * (B1 + s * (B2 + s * (B3 + s * B4))))
            for x in range(len(place)):
                place[x] = values[x]

"""How far lines reach: what is usual, what has an edge, what lies in the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from airline.stages.score_parts import bilinear

MIN_EDGE = 0.15  # probability of an edge, as the detector's threshold
GAP = 5.0  # px without an edge that do not end a line


@njit()
def usual_extents(ends):  # type: ignore[no-untyped-def]
    """(N, 2) medians of (N, 2, K) places where lines began and ended; NaN where they were not seen."""
    usual = np.empty(ends.shape[:2], np.float64)
    known = np.empty(ends.shape[2], np.float64)
    for n in range(len(ends)):
        for end in range(2):
            count = 0
            for k in range(ends.shape[2]):
                if not np.isnan(ends[n, end, k]):
                    known[count] = ends[n, end, k]
                    count += 1
            usual[n, end] = np.median(known[:count])
    return usual


@njit()
def supported(edges, segments, inner, outer):  # type: ignore[no-untyped-def]
    """How far lines reach along an edge beyond where they were seen, over gaps of 5 px.

    Args:
        edges: (H, W) float32 edge probability.
        segments: (N, 2, 2) px.
        inner: (N, 2) places along the segments, from 0 to 1, between which they were seen.
        outer: (N, 2) places up to which they may reach.

    Returns:
        (N, 2) places: the outer ones where they lie inside, otherwise as far from the inner ones as the edge goes.
    """
    reached = outer.copy()
    for n in range(len(segments)):
        x0, y0 = segments[n, 0, 0], segments[n, 0, 1]
        dx, dy = segments[n, 1, 0] - x0, segments[n, 1, 1] - y0
        length = max(np.hypot(dx, dy), 1e-6)
        nx, ny = -dy / length, dx / length
        for end in range(2):
            outwards = 2 * end - 1
            place, last = inner[n, end], inner[n, end]
            while outwards * (outer[n, end] - place) > 0:
                place += outwards / length
                x, y = x0 + place * dx, y0 + place * dy
                here = 0.0
                for j in range(-1, 2):
                    here = max(here, bilinear(edges, x + j * nx, y + j * ny))
                if here >= MIN_EDGE:
                    last = place
                elif abs(place - last) * length > GAP:
                    break
            if outwards * (outer[n, end] - last) > 0:
                reached[n, end] = last
    return reached


def visible_parts(
    segments: NDArray[np.floating], size: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Which parts of segments lie inside the image.

    Args:
        segments: (N, 2, 2) px.
        size: (width, height), px.

    Returns:
        (N,) where along each segment its part begins and ends, from 0 to 1, and its length, px; 0, 1 and length 0 where
        nothing is inside.
    """
    low, high, lengths = np.zeros(len(segments)), np.ones(len(segments)), np.zeros(len(segments))
    _visible(segments, low, high, lengths, size[0], size[1])
    return low, high, lengths


@njit()
def _visible(segments, lows, highs, lengths, width, height):  # type: ignore[no-untyped-def]
    for n in range(len(segments)):
        x, y = np.float64(segments[n, 0, 0]), np.float64(segments[n, 0, 1])
        dx, dy = segments[n, 1, 0] - x, segments[n, 1, 1] - y
        length = np.hypot(dx, dy)
        if not length > 0:
            continue
        low, high = _inside(x, y, dx / length, dy / length, length, width, height)
        if high > low:
            lows[n], highs[n], lengths[n] = low / length, high / length, high - low


@njit()
def _inside(x, y, ux, uy, length, width, height):  # type: ignore[no-untyped-def]
    """From where to where (x, y) + t (ux, uy), t from 0 to `length`, lies in the image; empty if the last is less."""
    low, high = 0.0, length
    for start, step, limit in ((x, ux, width - 0.5), (y, uy, height - 0.5)):
        if abs(step) > 1e-9:
            a, b = (-0.5 - start) / step, (limit - start) / step
            low, high = max(low, min(a, b)), min(high, max(a, b))
        elif start < -0.5 or start > limit:
            return 0.0, -1.0
    return low, high

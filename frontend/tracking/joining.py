"""Lines of tracks that broke in a frame are joined where the edge goes on between their pieces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from frontend.tracking.extents import GAP, edge_beside
from frontend.tracking.overlap import (
    MAX_DISTANCE,
    MAX_TWICE,
    MIN_COS,
    MIN_INSIDE,
    beside,
    lines_near,
    middles_and_lengths,
)
from frontend.tracking.pairing import Pairs
from frontend.tracking.seen import Seen
from frontend.tracking.table import TrackTable

REACH = 3.0  # px that a track's piece may lie from where the track was predicted


def joined(tracks: TrackTable, pairs: Pairs, seen: Seen, edges: NDArray[np.float32]) -> Seen:
    """The lines, those of tracks joined with their pieces of no track if the edge goes on in between.

    The line through both is fitted to each in proportion to its length. The row of a piece stays, marked as `joined`.

    Args:
        tracks: N predicted tracks.
        pairs: their lines.
        seen: these lines.
        edges: (H, W) float32 edge probability.
    """
    hit = np.flatnonzero(pairs >= 0)
    alone = np.ones(seen.detected, np.bool_)
    alone[pairs[hit]] = False
    free = np.flatnonzero(alone)
    lines, offsets = seen.features.segments[pairs[hit]], seen.errors[pairs[hit], 0, 0]
    pieces = seen.features.segments[free], seen.errors[free, 0, 0]
    changed, taken = _join(edges, tracks.segments[hit], lines, offsets, *pieces)
    if not changed.any():
        return seen
    rows = pairs[hit][changed]
    segments, errors, mask = seen.features.segments.copy(), seen.errors.copy(), seen.joined.copy()
    segments[rows], errors[rows, 0, 0], mask[free[taken]] = lines[changed], offsets[changed], True
    errors[rows, 1, 1] = 12 * offsets[changed] / ((lines[changed, 1] - lines[changed, 0]) ** 2).sum(axis=1)
    return replace(seen, features=replace(seen.features, segments=segments), errors=errors, joined=mask)


@njit()
def _join(edges, tracks, lines, offsets, pieces, piece_offsets):  # type: ignore[no-untyped-def]
    """Join lines and their variances of offset with their pieces; masks of lines that changed, of pieces taken."""
    changed, taken = np.zeros(len(lines), np.bool_), np.zeros(len(pieces), np.bool_)
    x, y, lengths = middles_and_lengths(tracks)
    near = np.empty(len(tracks), np.int64)
    for m in range(len(pieces)):
        piece, nearest, row = pieces[m], MAX_DISTANCE, -1
        length = np.hypot(piece[1, 0] - piece[0, 0], piece[1, 1] - piece[0, 1])
        for c in range(lines_near(piece, length, REACH, x, y, lengths, np.sqrt(1 - MIN_COS**2), near)):
            n = near[c]
            shared, _, _, cosine = beside(tracks[n], piece)
            if shared < MIN_INSIDE * length or abs(cosine) < MIN_COS:
                continue
            distance = _away(lines[n], piece)
            if distance < nearest and beside(lines[n], piece)[0] <= MAX_TWICE * length:
                nearest, row = distance, n
        if row >= 0 and _bridged(edges, lines[row], piece):
            offsets[row] = _fit(lines[row], offsets[row], piece, piece_offsets[m])
            changed[row] = taken[m] = True
    return changed, taken


@njit()
def _away(line, piece):  # type: ignore[no-untyped-def]
    """The larger distance of a piece's ends from the infinite line."""
    dx, dy = line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
    first = dx * (piece[0, 1] - line[0, 1]) - dy * (piece[0, 0] - line[0, 0])
    last = dx * (piece[1, 1] - line[0, 1]) - dy * (piece[1, 0] - line[0, 0])
    return max(abs(first), abs(last)) / max(np.hypot(dx, dy), 1e-6)


@njit()
def _bridged(edges, line, piece):  # type: ignore[no-untyped-def]
    """Whether the edge goes on between the ends of two lines that are next to each other."""
    a, b, shortest = 0, 0, np.inf
    for i in range(2):
        for j in range(2):
            gap = np.hypot(piece[j, 0] - line[i, 0], piece[j, 1] - line[i, 1])
            if gap < shortest:
                a, b, shortest = i, j, gap
    if shortest <= GAP:
        return True
    ux, uy = (piece[b, 0] - line[a, 0]) / shortest, (piece[b, 1] - line[a, 1]) / shortest
    last = 0.0
    for k in range(1, int(shortest)):
        if edge_beside(edges, line[a, 0] + k * ux, line[a, 1] + k * uy, -uy, ux):
            last = float(k)
        elif k - last > GAP:
            return False
    return True


@njit()
def _fit(line, offset, piece, piece_offset):  # type: ignore[no-untyped-def]
    """Make a line the one through itself and a piece, from the first to the last end; its variance of offset."""
    dx, dy = line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
    ex, ey = piece[1, 0] - piece[0, 0], piece[1, 1] - piece[0, 1]
    own, other = np.hypot(dx, dy), np.hypot(ex, ey)
    v, w = own / (own + other), other / (own + other)
    mx = 0.5 * (piece[0, 0] + piece[1, 0] - line[0, 0] - line[1, 0])
    my = 0.5 * (piece[0, 1] + piece[1, 1] - line[0, 1] - line[1, 1])
    cx, cy = 0.5 * (line[0, 0] + line[1, 0]) + w * mx, 0.5 * (line[0, 1] + line[1, 1]) + w * my
    xx = (v * dx * dx + w * ex * ex) / 12 + v * w * mx * mx
    xy = (v * dx * dy + w * ex * ey) / 12 + v * w * mx * my
    yy = (v * dy * dy + w * ey * ey) / 12 + v * w * my * my
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    ux, uy = np.cos(angle), np.sin(angle)
    if ux * dx + uy * dy < 0:
        ux, uy = -ux, -uy
    low, high = np.inf, -np.inf
    for end in range(2):
        for x, y in ((line[end, 0], line[end, 1]), (piece[end, 0], piece[end, 1])):
            along = ux * (x - cx) + uy * (y - cy)
            low, high = min(low, along), max(high, along)
    line[0, 0], line[0, 1], line[1, 0], line[1, 1] = cx + low * ux, cy + low * uy, cx + high * ux, cy + high * uy
    misfit = max(uy * uy * xx - 2 * ux * uy * xy + ux * ux * yy, 0.0)
    return v * v * offset + w * w * piece_offset + misfit

"""Tracks that no detected line takes are looked for on the edge map, where they should be.

As in the paper's local edge voting, stations along the line vote for where it lies across itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from airline.stages.score_parts import bilinear
from frontend.tracking.appearance import side_profiles
from frontend.tracking.config import TrackerConfig
from frontend.tracking.extents import MIN_EDGE
from frontend.tracking.measurement import MEASURED, line_covariances
from frontend.tracking.overlap import LineFeatures, covered
from frontend.tracking.pairing import Pairs
from frontend.tracking.seen import Seen
from frontend.tracking.state import innovations
from frontend.tracking.table import TrackTable

LOOKED_FOR = 3  # frames without the line after which it is not looked for any more
SHORTEST = 8.0  # px, of a line that is looked for
MAX_BAND = np.float32(3.0)  # px
STEP = 3.0  # px between stations along the line
LEAST, MOST = 5, 60  # stations of a line
ACROSS = 1.0  # px between samples across it
RIDGE = 0.75  # samples that the top of a ridge may be from the strongest, which is the nearer one of two alike
NEAR = 0.75  # px, of stations that agree with the line
ROUNDS = 5  # of the fit


def look_for(
    tracks: TrackTable,
    pairs: Pairs,
    lengths: NDArray[np.float64],
    seen: Seen,
    edges: NDArray[np.float32],
    gray: NDArray[np.uint8],
    config: TrackerConfig,
    noise: float,
) -> tuple[Pairs, Seen]:
    """Measure the tracks without a line on the edge map.

    A line is accepted that has an edge along most of it, half the length of what is predicted, both sides that look
    like the track's, and a place that passes the gate; unless it lies on a detected one.

    Args:
        tracks: N predicted tracks, with `lengths` (N,) px inside the image.
        pairs: their lines among those detected.
        seen: these lines.
        edges: (H, W) float32 edge probability, and `gray` the image.
        noise: of the frame, see `pairing.gated`.

    Returns:
        The pairs and lines with those that were found.
    """
    rows = np.flatnonzero((pairs < 0) & (lengths >= SHORTEST) & (tracks.missed <= LOOKED_FOR))
    alone = tracks.take(rows)
    segments, residuals, support, strength = measure(edges, alone.segments, np.minimum(1 + 2 * alone.spread, MAX_BAND))
    delta, profiles = segments[:, 1] - segments[:, 0], side_profiles(gray, segments)
    errors = line_covariances(segments, residuals, MEASURED)
    squares = innovations(alone.segments, alone.covariances, segments, errors)[2]
    good = (support >= config.min_support) & (squares <= config.gate * noise)
    good &= np.hypot(delta[:, 0], delta[:, 1]) >= np.maximum(SHORTEST, 0.5 * lengths[rows])
    good &= (profiles * alone.profiles).sum(axis=1) >= config.min_appearance_measured
    good &= (profiles * alone.first_profiles).sum(axis=1) >= config.min_appearance_first
    good[good] = ~covered(segments[good], seen.features.segments)
    found = LineFeatures(segments[good], alone.descriptors[good], profiles[good])
    pairs = pairs.copy()
    pairs[rows[good]] = len(seen.scores) + np.arange(good.sum())
    return pairs, Seen(
        seen.features.append(found),
        np.concatenate([seen.errors, errors[good]]),
        np.concatenate([seen.scores, (support * strength)[good]]),
        seen.detected,
    )


def measure(
    edges: NDArray[np.float32], segments: NDArray[np.float32], bands: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Lines on the edge map within a band around predicted ones.

    Each station along the line votes for the offset of the strongest edge across it; the straight line that most of
    them agree with is fitted by reweighted least squares (Tukey's biweight), and ends where they do.

    Args:
        edges: (H, W) float32 edge probability.
        segments: (N, 2, 2) float32 px.
        bands: (N,) float32 px, half widths.

    Returns:
        (N, 2, 2) float32 px, in the directions of the predicted ones; (N,) float32 rms distance of the stations that
        agree, px; (N,) float32 their share of those between the ends, 0 where nothing was found; and (N,) float32
        their mean edge probability.
    """
    found = segments.copy()
    residuals, support, strength = (np.zeros(len(segments), np.float32) for _ in range(3))
    _measure(edges, found, bands, residuals, support, strength)
    return found, residuals, support, strength


@njit()
def _measure(edges, segments, bands, residuals, support, strength):  # type: ignore[no-untyped-def]
    offset, value = np.empty(MOST), np.empty(MOST)
    for n in range(len(segments)):
        x0, y0 = np.float64(segments[n, 0, 0]), np.float64(segments[n, 0, 1])
        dx, dy = segments[n, 1, 0] - x0, segments[n, 1, 1] - y0
        length = np.hypot(dx, dy)
        if length < 4:
            continue
        ux, uy = dx / length, dy / length
        count = min(max(int(length / STEP), LEAST), MOST)
        half = int(bands[n] / ACROSS + 0.5)
        for k in range(count):
            t = (k + 0.5) / count * length
            x, y = x0 + t * ux, y0 + t * uy
            best, place = 0.0, 0
            for j in range(-half, half + 1):
                e = bilinear(edges, x - j * ACROSS * uy, y + j * ACROSS * ux)
                e *= 1 - 0.3 * abs(j) / (half + 1)
                if e > best:
                    best, place = e, j
            here = bilinear(edges, x - place * ACROSS * uy, y + place * ACROSS * ux)
            value[k] = here
            offset[k] = place * ACROSS
            a = bilinear(edges, x - (place - 1) * ACROSS * uy, y + (place - 1) * ACROSS * ux)
            b = bilinear(edges, x - (place + 1) * ACROSS * uy, y + (place + 1) * ACROSS * ux)
            curvature = 2 * here - a - b
            if here < MIN_EDGE or curvature <= 0 or abs(b - a) > 2 * RIDGE * curvature:
                value[k] = 0  # no ridge runs along here
            else:
                offset[k] += ACROSS * 0.5 * (b - a) / curvature
        _fit(n, segments, offset, value, count, length, ux, uy, residuals, support, strength)


@njit()
def _fit(n, segments, offset, value, count, length, ux, uy, residuals, support, strength):  # type: ignore[no-untyped-def]
    """Fit offset = a + b s, s from -1/2 to 1/2 along the line, and write down the line that follows."""
    votes = 0
    for k in range(count):
        votes += value[k] > 0
    if votes < LEAST - 1 or votes < 0.4 * count:
        return
    chosen = np.empty(votes)
    votes = 0
    for k in range(count):
        if value[k] > 0:
            chosen[votes] = offset[k]
            votes += 1
    a, b = float(np.median(chosen)), 0.0
    for turn in range(ROUNDS):
        reach = 3 * NEAR if turn < 2 else 2 * NEAR
        s0, s1, s2, m0, m1 = 1e-9, 0.0, 0.02, 0.0, 0.0
        for k in range(count):
            s = (k + 0.5) / count - 0.5
            away = (offset[k] - a - b * s) / reach
            w = value[k] * (1 - away * away) ** 2 if abs(away) < 1 else 0.0
            s0, s1, s2 = s0 + w, s1 + w * s, s2 + w * s * s
            m0, m1 = m0 + w * offset[k], m1 + w * s * offset[k]
        det = s0 * s2 - s1 * s1
        if det < 1e-9:
            return
        a, b = (m0 * s2 - m1 * s1) / det, (m1 * s0 - m0 * s1) / det
    first, last, agree, squares, total = count, -1, 0, 0.0, 0.0
    for k in range(count):
        away = offset[k] - a - b * ((k + 0.5) / count - 0.5)
        if value[k] > 0 and abs(away) <= NEAR:
            first, last = min(first, k), k
            agree += 1
            squares += away * away
            total += value[k]
    if agree < LEAST - 1:
        return
    x0, y0 = segments[n, 0, 0], segments[n, 0, 1]
    for end, place in ((0, first / count), (1, (last + 1) / count)):
        across, along = a + b * (place - 0.5), place * length
        segments[n, end, 0], segments[n, end, 1] = x0 + along * ux - across * uy, y0 + along * uy + across * ux
    residuals[n] = np.sqrt(squares / agree)
    support[n] = agree / (last + 1 - first)
    strength[n] = total / agree

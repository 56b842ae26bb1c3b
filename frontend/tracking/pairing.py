"""Which line each track goes on with: votes, one-to-one pairs, and a gate for those that are not where they must be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.tracking.assignment import assign
from frontend.tracking.camera_motion import MEDIAN_SQUARE
from frontend.tracking.config import TrackerConfig
from frontend.tracking.overlap import LineFeatures, overlap_votes
from frontend.tracking.seen import Seen
from frontend.tracking.state import innovations
from frontend.tracking.table import TrackTable

Pairs = NDArray[np.int32]  # row of the line that each track goes on with, or -1

LATELY = 1  # frames that a confirmed track may have been missed and still choose with those just seen
LEAST_PAIRS = 10  # from which the noise of a frame is told
NEAR_ENOUGH = 1.0  # px; lines that end no farther from their track pass the gate,
MOST_SURPRISE = 4.0  # as long as the track's recent squared innovations are no more than this
CALM_SQUARE = 5.0  # squared innovation that casts no doubt on a line that looks unlike its track at its birth


def pair(tracks: TrackTable, seen: LineFeatures, config: TrackerConfig) -> Pairs:
    """The line of each track: first for those seen lately, so that one odd line ends none, then for the others."""
    current = tracks.missed == 0
    early = current | ((tracks.hits >= config.confirm_hits) & (tracks.missed <= LATELY))
    most = np.where(current, config.max_band, config.max_lost_band)
    votes = overlap_votes(
        tracks.features,
        seen,
        np.minimum(config.band + 3 * tracks.spread, most).astype(np.float32),
        tracks.seen_parts,
        np.where(current, config.min_appearance, config.min_appearance_lost).astype(np.float32),
        max_angle=np.deg2rad(config.max_angle),
        min_agreement=config.min_agreement,
    )
    pairs = assign(votes, config.min_vote, rows=early)
    free = np.ones(len(seen.segments), np.bool_)
    free[pairs[pairs >= 0]] = False
    return np.maximum(pairs, assign(votes, config.min_vote, rows=~early, columns=free))


def gated(tracks: TrackTable, pairs: Pairs, seen: Seen, config: TrackerConfig) -> tuple[Pairs, float]:
    """The pairs without those of which the line is not where the track must be, or looks unlike it at its birth.

    Returns:
        The pairs, and the frame's noise: how large squared innovations are in the median, over what their covariances
        let expect, at least 1. All are judged by it, so that a motion that is not quite right ends no tracks.
    """
    hit = np.flatnonzero(pairs >= 0)
    paired = tracks.take(hit)
    lines = seen.along(pairs[hit], paired.segments)
    _, _, squares, away = innovations(paired.segments, paired.covariances, lines.segments, seen.errors[pairs[hit]])
    noise = max(1.0, float(np.median(squares)) / MEDIAN_SQUARE) if len(hit) >= LEAST_PAIRS else 1.0
    squares = squares / noise
    far = (squares > config.gate) & ((away > NEAR_ENOUGH) | (paired.surprise > MOST_SURPRISE))
    changed = (lines.profiles * paired.first_profiles).sum(axis=1) < config.min_appearance_first
    kept = pairs.copy()
    kept[hit[far | (changed & (squares > CALM_SQUARE))]] = -1
    return kept, noise

"""Tracks after a frame: filtered with their lines, as long as these were lately."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from frontend.tracking.config import TrackerConfig
from frontend.tracking.extents import supported, usual_extents, visible_parts
from frontend.tracking.pairing import Pairs
from frontend.tracking.seen import Seen
from frontend.tracking.state import innovations, slide, update
from frontend.tracking.table import TrackTable

MEMORY = 0.5  # weight of the past in a track's profile,
CALM = 0.8  # and in how surprising its lines are


def corrected(
    tracks: TrackTable,
    pairs: Pairs,
    seen: Seen,
    edges: NDArray[np.float32] | None,
    size: tuple[int, int],
    config: TrackerConfig,
    noise: float,
) -> TrackTable:
    """The tracks with one more frame; those that have a line are filtered with it.

    Along itself a line reaches from where it began to where it ended in the median of the last frames, but not beyond
    where it was seen in this one farther than the edge goes.

    Args:
        tracks: N predicted tracks.
        pairs: their lines.
        seen: these lines.
        edges: (H, W) float32 edge probability, where it is known.
        size: width and height of the image, px.
        noise: of the frame, see `pairing.gated`.
    """
    hit = pairs >= 0
    here, rows = tracks.take(hit), pairs[hit]
    lines = seen.along(rows, here.segments)
    offsets, spread, squares, _ = innovations(here.segments, here.covariances, lines.segments, seen.errors[rows])
    squares = squares / noise
    spread *= np.maximum(1, squares / config.gate)[:, None, None]  # what passed the gate by its distance counts less
    segments, depths, covariances = update(here.segments, here.depths, here.covariances, offsets, spread)
    ends = np.concatenate([here.ends[:, :, 1:], _along(segments, lines.segments)[:, :, None]], axis=2)
    extents = usual_extents(ends)
    if edges is not None:
        extents = supported(edges, segments, ends[:, :, -1], extents)
    start, delta = segments[:, :1], segments[:, 1:] - segments[:, :1]
    first, last, _ = visible_parts(start + extents[:, :, None] * delta, size)
    reach = (extents[:, 1] - extents[:, 0])[:, None] * np.stack([first, last], axis=1)
    low, high = np.ascontiguousarray((extents[:, :1] + reach).T)
    segments, depths, covariances = slide(segments, depths, covariances, low, high)
    values = {
        "segments": segments,
        "depths": depths,
        "covariances": covariances,
        "ends": (ends - low[:, None, None]) / (high - low)[:, None, None],
        "descriptors": lines.descriptors,
        "profiles": MEMORY * here.profiles + (1 - MEMORY) * lines.profiles,
        "surprise": CALM * here.surprise + (1 - CALM) * np.minimum(squares / 2, config.gate),
    }
    return replace(
        tracks.with_rows(hit, values),
        hits=(tracks.hits + hit).astype(np.int32),
        missed=np.where(hit, 0, tracks.missed + 1).astype(np.int32),
        visible=hit,
    )


def _along(segments: NDArray[np.float64], points: NDArray[np.float32]) -> NDArray[np.float64]:
    """(N, K) places of (N, K, 2) points along (N, 2, 2) segments, from 0 at the start to 1 at the end."""
    delta = segments[:, None, 1] - segments[:, None, 0]
    dots = ((points - segments[:, :1]) * delta).sum(axis=2)
    return np.asarray(dots / np.maximum((delta * delta).sum(axis=2), 1e-6))

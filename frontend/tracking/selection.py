"""The best of a frame's tracks, for backends that want no more than so many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from frontend.tracks import FIELDS, LineTracks

GRID = (8, 6)  # cells across and down, each of which has its best line taken before any has its second
LONG = 120.0  # px; longer lines are no better
SETTLED = 5.0  # frames seen, after which a track is worth half of one that was always there
NEW = 0.5  # what a track is worth that was not taken in the last frame: equals do not take turns


class Selection:
    """Restricts each frame's tracks to the best; one per stream of frames, fed in time order.

    Args:
        count: most tracks per frame; 0 is all.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._taken = self._known = np.zeros(0, np.int64)  # ids: of the last frame, and of all that have not ended

    def of(self, tracks: LineTracks, size: tuple[int, int]) -> LineTracks:
        """The best of the tracks, and of the lost and ended ones those that were handed out before."""
        if not self._count:
            return tracks
        rows = best(tracks, size, self._count, _among(tracks.ids, self._taken))
        self._taken = tracks.ids[rows]
        known = np.union1d(self._known, self._taken)
        keep = {"lost": _among(tracks.lost_ids, known), "ended": _among(tracks.ended_ids, known)}
        self._known = known[~_among(known, tracks.ended_ids)]
        others = {f.name: getattr(tracks, f.name)[keep[f.rows]] for f in FIELDS if f.rows in keep}
        return replace(tracks.take(rows), **others, left_out=len(tracks) - len(rows))


def best(tracks: LineTracks, size: tuple[int, int], count: int, taken: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Ascending rows of the `count` best tracks: confirmed ones, spread over the image, long, old and consistent.

    Args:
        tracks: N tracks.
        size: width and height of the image, px.
        count: how many.
        taken: (N,) mask of those that were taken in the last frame.
    """
    ends, confirmed = tracks.segments_px, tracks.confirmed
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    worth = np.minimum(length / LONG, 1) * tracks.hits / (tracks.hits + SETTLED)
    worth = worth / np.fmax(tracks.consistency, 1) * np.where(taken, 1, NEW)
    worth += confirmed & (tracks.stable | taken)  # one that was taken and is not stable now pays by its consistency

    middles = (ends[:, 0] + ends[:, 1]) / 2
    across, down = np.clip(middles * np.divide(GRID, size), 0, np.array(GRID) - 1).astype(np.intp).T
    cell = down * GRID[0] + across
    order = np.lexsort((-worth, ~confirmed, cell))
    in_order = cell[order]
    rank = np.empty(len(order), np.intp)
    rank[order] = np.arange(len(order)) - np.searchsorted(in_order, in_order)
    # a taken one may fall back by a place: one line that crosses into another cell makes no other come and go
    return np.sort(np.lexsort((-worth, rank - taken, ~confirmed))[:count])


def _among(ids: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) mask of the ids that are among the others; no id comes twice in either."""
    return np.isin(ids, others, assume_unique=True, kind="sort")

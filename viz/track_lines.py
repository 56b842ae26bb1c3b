"""Tracks as Rerun draws them: the state of each line at a glance, its colour from its id."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from frontend.colours import track_colours
from frontend.tracks import LineTracks
from viz.strips import packed, strips_2d

FRAGMENT_TONE = 0.55  # how dark a piece of a broken line is beside whole ones
LOST_TONE, LOST_GREY = 0.2, 120  # how much of its hue a lost line keeps, on which grey
CONFIRMED_RADIUS, TENTATIVE_RADIUS, LOST_RADIUS, TAIL_RADIUS = 1.5, 0.75, 0.4, 0.6  # points of the screen
TAIL_FRAMES, TAIL_STEP = 12, 3
TAIL_TONE = 0.75  # how dark a tail is beside its line


class Tails:
    """Where the lines' middles were in the last frames. One per stream of frames, fed in time order.

    A tail bends only at every `step`-th frame: that hides tremble, and places that stay the same for several frames
    compress well.
    """

    def __init__(self, frames: int = TAIL_FRAMES, step: int = TAIL_STEP) -> None:
        self._step = step
        self._added = 0
        self._ids = np.zeros(0, np.int64)
        self._bends = np.zeros((0, frames // step, 2), np.float32)

    def add(self, tracks: LineTracks) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.intp]]:
        """Take the next frame's tracks.

        Returns:
            (N,) rows of the confirmed tracks that have a tail; (P, 2) float32 px, the points of all tails, each from
            the oldest place to the present one; (N,) how many of them each tail has.
        """
        ids = np.sort(np.concatenate([tracks.ids, tracks.lost_ids]))
        bends = np.full((len(ids), *self._bends.shape[1:]), np.nan, np.float32)
        before = np.searchsorted(self._ids, ids)
        now = np.flatnonzero(np.append(self._ids, -1)[before] == ids)
        bends[now] = self._bends[before[now]]
        here, middles = np.searchsorted(ids, tracks.ids), tracks.segments_px.mean(axis=1)
        points = np.concatenate([bends[here], middles[:, None]], axis=1)
        if self._added % self._step == 0:
            bends[:, :-1], bends[:, -1] = bends[:, 1:], np.nan
            bends[here, -1] = middles
        self._ids, self._bends, self._added = ids, bends, self._added + 1
        known = ~np.isnan(points[:, :, 0])
        rows = np.flatnonzero(tracks.confirmed & (known.sum(axis=1) > 1))
        return rows, points[rows][known[rows]], known[rows].sum(axis=1)


def log_tracks(
    stream: rr.RecordingStream,
    tracks: LineTracks,
    tails: Tails | None = None,
    *,
    root: str = "/camera",
    colour_ids: NDArray[np.int64] | None = None,
) -> None:
    """Log one frame's tracks at the stream's present time.

    `root/tracks`: confirmed lines bright and thick, tentative ones pale and thin, pieces of broken lines darker, each
    with its id as the component `track_id`. `root/tracks/lost`: where lines that are looked for should be, thin and
    grey. `root/tails`: where the middles of confirmed lines were.

    Args:
        stream: where to log to; the caller has set its time.
        tracks: what was seen in one frame.
        tails: of this stream of frames; None logs no tails.
        root: entity whose picture they lie on.
        colour_ids: (N,) int64 the tracks are coloured as if they had these ids; None: their own.
    """
    ids = tracks.ids if colour_ids is None else colour_ids
    stream.log(f"{root}/tracks", *_seen(tracks, ids))
    stream.log(f"{root}/tracks/lost", *_lost(tracks))
    if tails is not None:
        rows, points, lengths = tails.add(tracks)
        colours = packed((TAIL_TONE * track_colours(ids[rows])).astype(np.uint8))
        radius = rr.Radius.ui_points(TAIL_RADIUS)
        stream.log(f"{root}/tails", rr.LineStrips2D(strips_2d(points, lengths), colors=colours, radii=radius))


def _seen(tracks: LineTracks, ids: NDArray[np.int64]) -> tuple[rr.LineStrips2D, rr.AnyValues]:
    confirmed = tracks.confirmed
    colours = track_colours(ids, confirmed)
    fragments = tracks.fragment_of >= 0
    colours[fragments] = (colours[fragments] * FRAGMENT_TONE).astype(np.uint8)
    strips = rr.LineStrips2D(
        strips_2d(tracks.segments_px),
        colors=packed(colours),
        radii=rr.Radius.ui_points(np.where(confirmed, CONFIRMED_RADIUS, TENTATIVE_RADIUS)),
    )
    return strips, rr.AnyValues(track_id=tracks.ids)


def _lost(tracks: LineTracks) -> tuple[rr.LineStrips2D, rr.AnyValues]:
    colours = (track_colours(tracks.lost_ids) * LOST_TONE + LOST_GREY * (1 - LOST_TONE)).astype(np.uint8)
    radius = rr.Radius.ui_points(LOST_RADIUS)
    strips = rr.LineStrips2D(strips_2d(tracks.lost_segments_px), colors=packed(colours), radii=radius)
    return strips, rr.AnyValues(track_id=tracks.lost_ids)

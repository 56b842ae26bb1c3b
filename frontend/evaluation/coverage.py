"""How much of a true line's visible life its track covers, and how many tracks are too short to be of use."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from frontend.evaluation.metrics import Figures, figure, ratio, whole_tracks
from frontend.evaluation.truth import Record, owners
from frontend.tracks import LineTracks

MIN_PIECE = 15.0  # px that make a true line visible
MIN_VISIBLE = 5  # frames
MOST = 0.8  # of a life
SHORT = 3  # frames

Ids = NDArray[np.int64]


def coverage(records: Sequence[Record]) -> Figures:
    """Figures of the lives of true lines and of tracks; None where there are none.

    A true line is visible in the frames in which a piece of it is at least 15 px long and no other true line lies so
    near that a detection could belong to either, see `owners`. Of the lines visible in 5 frames and more, those count
    that were detected in one at least: no tracker can begin where nothing is found. A line's main
    track is the one with most frames on it, pieces counted as the track they are of; it covers the visible frames in
    which it is on the line. `coverage` is all covered frames over all visible ones, `coverage_of_all` the same with
    lines that were never detected; `covered_most` the share of lines covered for 80 % of their life.

    `under_3` is the share of tracks seen in fewer than 3 frames; `confirmed_under_3` the same of those that ever were
    confirmed, by id, None for trackers without such a state.
    """
    visible = [_visible(record) for record in records]
    lines, frames = _seen(visible)
    lines, frames = lines[frames >= MIN_VISIBLE], frames[frames >= MIN_VISIBLE]
    covered = _covered(records, visible, lines)
    found = np.isin(lines, _seen([record.detected for record in records])[0])
    return {
        "lines": int(found.sum()),
        "visible_mean": figure(np.mean, frames[found]),
        "covered_mean": figure(np.mean, covered[found]),
        "coverage": ratio(covered[found].sum(), frames[found].sum()),
        "coverage_of_all": ratio(covered.sum(), frames.sum()),
        "covered_most": figure(np.mean, covered[found] >= MOST * frames[found]),
        "under_3": figure(np.mean, _seen(whole_tracks(records))[1] < SHORT),
        "confirmed_under_3": _confirmed_under(records),
    }


def _visible(record: Record) -> Ids:
    truth = record.truth
    delta = truth.segments_px[:, 1] - truth.segments_px[:, 0]
    long = np.hypot(delta[:, 0], delta[:, 1]) >= MIN_PIECE
    return np.unique(truth.ids[long & (owners(truth.segments_px, truth) == truth.ids)])


def _covered(records: Sequence[Record], visible: Sequence[Ids], lines: Ids) -> Ids:
    """(L,) frames in which each line was visible and its main track was on it."""
    on = [np.zeros((0, 2), np.int64)]  # line and track, once for every frame
    for record, tracks, seen in zip(records, whole_tracks(records), visible, strict=True):
        rows = np.isin(record.owners, seen)
        on.append(np.unique(np.stack([record.owners[rows], tracks[rows]], axis=1), axis=0))
    pairs, frames = np.unique(np.concatenate(on), axis=0, return_counts=True)
    covered = np.zeros(len(lines), np.int64)
    known = np.isin(pairs[:, 0], lines)
    np.maximum.at(covered, np.searchsorted(lines, pairs[known, 0]), frames[known])
    return covered


def _confirmed_under(records: Sequence[Record]) -> float | None:
    tracks = [record.tracked for record in records if isinstance(record.tracked, LineTracks)]
    ids, frames = _seen([found.ids for found in tracks])
    confirmed = np.isin(ids, _seen([found.ids[found.confirmed] for found in tracks])[0])
    return figure(np.mean, frames[confirmed] < SHORT)


def _seen(ids: Sequence[Ids]) -> tuple[Ids, Ids]:
    """Ids, and in how many frames each was."""
    return np.unique(np.concatenate([np.zeros(0, np.int64), *map(np.unique, ids)]), return_counts=True)

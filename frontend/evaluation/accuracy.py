"""How near a tracker's lines are to the true lines, and how much they tremble."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from frontend.evaluation.metrics import Figures, figure, linked, rms
from frontend.evaluation.truth import Record, longest_pieces
from frontend.tracks import LineTracks

BORDER = 2.0  # px: a true end point nearer to the image's border is where the image ends, not the line
SEEN = 4  # frames before a line counts, so that there is something to fuse
ONE_SIGMA = 68.27  # percent of normal errors within one standard deviation
CLIPPED = 3.0  # standard deviations

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


def jitter(records: Sequence[Record]) -> Figures:
    """Root mean square jitter of the end points, px, across and along the true lines; None without any.

    Across: an end point's signed distance to the true line. Along: its place from the true end point on its side, of
    true lines in one piece, where that end is not at the image's border. Changes from frame to frame are differences of
    two errors, so their mean square is halved; constant errors and slow drift add nothing. Only right links count.
    """
    steps = [np.zeros((0, 2, 2))]
    for before, after in pairwise(records):
        rows, later_rows = linked(before, after)
        same = (before.owners[rows] >= 0) & (before.owners[rows] == after.owners[later_rows])
        rows, later_rows = rows[same], later_rows[same]
        first, later = before.tracked.segments_px[rows], after.tracked.segments_px[later_rows]
        backwards = _backwards(first, _true_lines(before, rows))
        steps.append(_deviation(after, later_rows, later, backwards) - _deviation(before, rows, first, backwards))
    across, along = np.concatenate(steps).reshape(-1, 2).T * np.sqrt(0.5)
    return {"jitter_across_px": figure(rms, across), "jitter_along_px": figure(rms, along)}


def accuracy(records: Sequence[Record]) -> dict[str, Figures]:
    """Errors of lines with known true lines, of tracks seen in more than three frames; None without any.

    Of these rows `fused` are the fused lines, `observed` what was observed, `detected` and `measured` the two kinds of
    it. Across: distances of the end points to the true infinite line, px, root mean square and what 68 % are
    below. Along: from the true end points, where they are known, see `jitter`. Normalised errors are those of the
    offset at the line's middle and of its angle over the standard deviations that the tracker gives: what 68 % are
    below, and the root mean square with errors cut at 3; both are 1 if covariances are honest.
    """
    errors: dict[str, list[Array]] = {
        kind: [np.zeros((0, 6))] for kind in ("fused", "observed", "detected", "measured")
    }
    for record in records:
        tracked = record.tracked
        if not isinstance(tracked, LineTracks):
            continue
        rows = np.flatnonzero((record.owners >= 0) & (tracked.hits >= SEEN))
        errors["fused"].append(_errors(record, rows, tracked.segments_px, tracked.covariances))
        observed = _errors(record, rows, tracked.observed_px, tracked.observed_covariances)
        errors["observed"].append(observed)
        errors["detected"].append(observed[~tracked.measured[rows]])
        errors["measured"].append(observed[tracked.measured[rows]])
    return {kind: _figures(np.concatenate(found)) for kind, found in errors.items()}


def _errors(record: Record, rows: Rows, segments: NDArray[np.float32], covariances: NDArray[np.float32]) -> Array:
    """(N, 6): of both ends across and along, px; of the middle and the angle, in standard deviations."""
    lines = segments[rows].astype(np.float64)
    ends = _deviation(record, rows, lines, _backwards(lines, _true_lines(record, rows)))
    delta = lines[:, 1] - lines[:, 0]
    turned = np.arcsin(np.clip((ends[:, 1, 0] - ends[:, 0, 0]) / np.hypot(delta[:, 0], delta[:, 1]), -1, 1))
    sigmas = np.sqrt(covariances[rows][:, [0, 1], [0, 1]].astype(np.float64))
    normalised = np.stack([ends[:, :, 0].mean(axis=1), turned], axis=1) / sigmas
    return np.concatenate([ends[:, :, 0], ends[:, :, 1], normalised], axis=1)


def _figures(errors: Array) -> Figures:
    across, along, (offset, angle) = errors[:, :2].ravel(), errors[:, 2:4].ravel(), errors[:, 4:].T
    return {
        "lines": len(errors),
        "across_px": figure(rms, across),
        "across_68_px": figure(_one_sigma, across),
        "along_px": figure(rms, along),
        "offset_68": figure(_one_sigma, offset),
        "offset_rms": figure(rms, np.clip(offset, -CLIPPED, CLIPPED)),
        "angle_68": figure(_one_sigma, angle),
        "angle_rms": figure(rms, np.clip(angle, -CLIPPED, CLIPPED)),
    }


def _one_sigma(errors: Array) -> float:
    return float(np.percentile(np.abs(errors), ONE_SIGMA))


def _true_lines(record: Record, rows: Rows) -> Array:
    """(N, 2, 2) the longest piece of the true line of each row, px."""
    return record.truth.segments_px[longest_pieces(record.truth, record.owners[rows])].astype(np.float64)


def _backwards(segments: Array | NDArray[np.float32], lines: Array) -> NDArray[np.bool_]:
    """(N,) mask of the segments that point against their lines."""
    return np.asarray(((segments[:, 1] - segments[:, 0]) * _unit(lines)).sum(axis=1) < 0)


def _deviation(
    record: Record, rows: Rows, segments: Array | NDArray[np.float32], backwards: NDArray[np.bool_]
) -> Array:
    """(N, 2, 2) px, per end, across and along from the rows' true lines, which `backwards` turns; NaN: unknown."""
    lines = _true_lines(record, rows)
    ends = np.where(backwards[:, None, None], lines[:, ::-1], lines)
    direction = _unit(ends)
    offset = segments - ends
    across = offset[:, :, 1] * direction[:, None, 0] - offset[:, :, 0] * direction[:, None, 1]
    along = np.einsum("nec,nc->ne", offset, direction)
    limits = np.array(record.size) - 1 - BORDER
    ids, pieces = np.unique(record.truth.ids, return_counts=True)
    whole = pieces[np.searchsorted(ids, record.owners[rows])] == 1
    along[~((ends > BORDER) & (ends < limits)).all(axis=2) | ~whole[:, None]] = np.nan
    return np.stack([across, along], axis=2)


def _unit(lines: Array) -> Array:
    delta = lines[:, 1] - lines[:, 0]
    return np.asarray(delta / np.hypot(delta[:, 0], delta[:, 1])[:, None])

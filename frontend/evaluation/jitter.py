"""How much a tracker's end points tremble about the true motion."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from frontend.evaluation.clip import Truth
from frontend.evaluation.record import Record

BORDER = 2.0  # px: a true end point nearer to the image's border is where the image ends, not the line


def jitter(records: Sequence[Record]) -> tuple[float | None, float | None]:
    """Root mean square jitter of the end points, px, across and along the true lines; None without any.

    Across: an end point's signed distance to the true line. Along: its place along the true line, from the true end
    point on its side; only of true lines in one piece, at ends that are not at the image's border. From one frame to
    the next the two change by the difference of two errors, whose mean square is halved: a constant error or a slow
    drift adds nothing. Only links with the same true line in both frames count.
    """
    across, along = [np.zeros(0)], [np.zeros(0)]
    for before, after in pairwise(records):
        _, rows, later_rows = np.intersect1d(
            before.tracked.ids, after.tracked.ids, assume_unique=True, return_indices=True
        )
        same = (before.owners[rows] >= 0) & (before.owners[rows] == after.owners[later_rows])
        rows, later_rows = rows[same], later_rows[same]
        first, second = _true_lines(before, rows), _true_lines(after, later_rows)
        backwards = _along(before.tracked.segments_px[rows], first).sum(axis=1) < 0
        step = _deviation(after, later_rows, second, backwards) - _deviation(before, rows, first, backwards)
        across.append(step[:, :, 0].ravel())
        along.append(step[:, :, 1].ravel())
    return _root_mean_square(across), _root_mean_square(along)


def _true_lines(record: Record, rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """(N, 2, 2) the longest piece of the true line of each row, px."""
    truth = record.truth
    delta = truth.segments_px[:, 1] - truth.segments_px[:, 0]
    order = np.lexsort((np.hypot(delta[:, 0], delta[:, 1]), truth.ids))
    last = np.searchsorted(truth.ids[order], record.owners[rows], side="right") - 1
    return truth.segments_px[order[last]].astype(np.float64)


def _deviation(
    record: Record, rows: NDArray[np.intp], lines: NDArray[np.float64], backwards: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(N, 2, 2) px, per end point, across and along from the true line, which `backwards` turns about; NaN: unknown."""
    ends = np.where(backwards[:, None, None], lines[:, ::-1], lines)
    direction = _unit(ends)
    offset = record.tracked.segments_px[rows] - ends
    across = offset[:, :, 1] * direction[:, None, 0] - offset[:, :, 0] * direction[:, None, 1]
    along = np.einsum("nec,nc->ne", offset, direction)
    limits = np.array(record.size) - 1 - BORDER
    whole = _is_whole(record.truth, record.owners[rows])
    along[~((ends > BORDER) & (ends < limits)).all(axis=2) | ~whole[:, None]] = np.nan
    return np.stack([across, along], axis=2)


def _is_whole(truth: Truth, owners: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) mask of the owners that can be seen in one piece."""
    ids, counts = np.unique(truth.ids, return_counts=True)
    return np.asarray(counts[np.searchsorted(ids, owners)] == 1)


def _along(segments: NDArray[np.float32], lines: NDArray[np.float64]) -> NDArray[np.float64]:
    return (segments[:, 1] - segments[:, 0]) * _unit(lines)


def _unit(lines: NDArray[np.float64]) -> NDArray[np.float64]:
    delta = lines[:, 1] - lines[:, 0]
    return np.asarray(delta / np.hypot(delta[:, 0], delta[:, 1])[:, None])


def _root_mean_square(steps: list[NDArray[np.float64]]) -> float | None:
    step = np.concatenate(steps)
    step = step[~np.isnan(step)]
    return float(np.sqrt(0.5 * np.mean(step**2))) if len(step) else None

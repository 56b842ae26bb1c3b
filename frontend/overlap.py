"""How well predicted tracks and detected lines cover each other."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def overlap_votes(
    predicted: NDArray[np.float32],
    predicted_descriptors: NDArray[np.float32],
    detected: NDArray[np.float32],
    detected_descriptors: NDArray[np.float32],
    band: float,
    agreement: float,
) -> NDArray[np.float32]:
    """Votes of every predicted track for every detected line.

    A vote is the share of the shorter of the two that lies beside the other within `band` px, weighted by how close
    they run, `1 - distance / band`, and by the descriptors' dot product.

    Args:
        predicted: (N, 2, 2) px.
        predicted_descriptors: (N, C) unit rows.
        detected: (M, 2, 2) px.
        detected_descriptors: (M, C) unit rows.
        band: half width of the search band, px.
        agreement: pairs with a smaller dot product of descriptors earn nothing.

    Returns:
        (N, M) float32 in [0, 1].
    """
    likeness = predicted_descriptors @ detected_descriptors.T
    votes: NDArray[np.float32] = _votes(predicted, detected, likeness, band, agreement)
    return votes


def assign(votes: NDArray[np.float32], least: float) -> NDArray[np.int32]:
    """One-to-one pairs, strongest vote first.

    Args:
        votes: (N, M) float32.
        least: weaker votes make no pair.

    Returns:
        (N,) int32 column of each row, or -1.
    """
    chosen = np.full(votes.shape[0], -1, np.int32)
    taken = np.zeros(votes.shape[1], np.bool_)
    rows, columns = np.nonzero(votes >= least)
    for k in np.argsort(-votes[rows, columns], kind="stable"):
        if chosen[rows[k]] < 0 and not taken[columns[k]]:
            chosen[rows[k]] = columns[k]
            taken[columns[k]] = True
    return chosen


@njit(cache=True, nogil=True)
def _votes(predicted, detected, likeness, band, agreement):  # type: ignore[no-untyped-def]
    n, m = len(predicted), len(detected)
    votes = np.zeros((n, m), np.float32)
    for i in range(n):
        x0, y0 = predicted[i, 0, 0], predicted[i, 0, 1]
        ux, uy = predicted[i, 1, 0] - x0, predicted[i, 1, 1] - y0
        length = np.hypot(ux, uy)
        if length < 1e-3:
            continue
        ux, uy = ux / length, uy / length
        for j in range(m):
            if likeness[i, j] < agreement:
                continue
            ax, ay = detected[j, 0, 0] - x0, detected[j, 0, 1] - y0
            bx, by = detected[j, 1, 0] - x0, detected[j, 1, 1] - y0
            ta, tb = ax * ux + ay * uy, bx * ux + by * uy
            da, db = ay * ux - ax * uy, by * ux - bx * uy
            if ta > tb:
                ta, tb, da, db = tb, ta, db, da
            low, high = max(ta, 0.0), min(tb, length)
            if high <= low:
                continue
            slope = (db - da) / (tb - ta)
            at_low, at_high = abs(da + slope * (low - ta)), abs(da + slope * (high - ta))
            if max(at_low, at_high) > 2 * band:
                continue
            closeness = 1 - 0.5 * (at_low + at_high) / band
            if closeness > 0:
                votes[i, j] = (high - low) / min(length, tb - ta) * closeness * likeness[i, j]
    return votes

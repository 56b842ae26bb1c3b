"""Which track goes on with which line: the one-to-one pairs with the most votes in total."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit


def assign(
    votes: NDArray[np.float32],
    least: float,
    rows: NDArray[np.bool_] | None = None,
    columns: NDArray[np.bool_] | None = None,
) -> NDArray[np.int32]:
    """The one-to-one pairs whose votes add up to the most.

    Few lines lie near a track, so the pairs fall apart into small groups that share no track and no line. Each group is
    solved to its optimum by shortest augmenting paths (the Hungarian method after Jonker and Volgenant 1987).

    Args:
        votes: (N, M) float32.
        least: pairs with fewer votes do not exist.
        rows: (N,) mask of the rows to pair; all by default.
        columns: (M,) mask of the columns to pair; all by default.

    Returns:
        (N,) int32 column of each row, or -1.
    """
    n, m = votes.shape
    skipped_rows = np.zeros(n, np.bool_) if rows is None else ~rows
    skipped_columns = np.zeros(m, np.bool_) if columns is None else ~columns
    chosen: NDArray[np.int32] = _assign(votes, np.float32(least), skipped_rows, skipped_columns)
    return chosen


@njit()
def _assign(votes, least, row_seen, column_seen):  # type: ignore[no-untyped-def]
    n, m = votes.shape
    chosen = np.full(n, -1, np.int32)
    pairs, starts = _pairs(votes, least, row_seen, column_seen)
    column_starts = np.zeros(m + 1, np.int64)
    for pair in range(len(pairs)):
        column_starts[pairs[pair, 1] + 1] += 1
    for j in range(m):
        column_starts[j + 1] += column_starts[j]
    following, by_column = column_starts.copy(), np.empty(len(pairs), np.int64)
    for pair in range(len(pairs)):
        by_column[following[pairs[pair, 1]]] = pair
        following[pairs[pair, 1]] += 1
    rows, columns = np.empty(n, np.int64), np.empty(m, np.int64)
    for first in range(n):
        if row_seen[first] or starts[first] == starts[first + 1]:
            continue
        # the group of `first`: rows and columns reachable over existing pairs
        rows[0], row_count, column_count, reached = first, 1, 0, 0
        row_seen[first] = True
        while reached < row_count:
            i = rows[reached]
            reached += 1
            for pair in range(starts[i], starts[i + 1]):
                j = pairs[pair, 1]
                if column_seen[j]:
                    continue
                column_seen[j] = True
                columns[column_count] = j
                column_count += 1
                for place in range(column_starts[j], column_starts[j + 1]):
                    k = pairs[by_column[place], 0]
                    if not row_seen[k]:
                        row_seen[k] = True
                        rows[row_count] = k
                        row_count += 1
        _solve(votes, least, rows[:row_count], columns[:column_count], chosen)
    return chosen


@njit()
def _pairs(votes, least, skipped_rows, skipped_columns):  # type: ignore[no-untyped-def]
    """(P, 2) rows and columns with enough votes, row by row, and where each row begins among them."""
    n, m = votes.shape
    columns = np.empty(m + 1, np.int64)
    capacity = 0
    for i in range(n):
        for j in range(m):
            capacity += votes[i, j] >= least
    pairs, starts = np.empty((capacity, 2), np.int64), np.zeros(n + 1, np.int64)
    count = 0
    for i in range(n):
        here = 0
        if not skipped_rows[i]:
            for j in range(m):  # without branches: nearly all are no
                columns[here] = j
                here += votes[i, j] >= least
        for c in range(here):
            if not skipped_columns[columns[c]]:
                pairs[count, 0], pairs[count, 1] = i, columns[c]
                count += 1
        starts[i + 1] = count
    return pairs[:count], starts


@njit()
def _solve(votes, least, rows, columns, chosen):  # type: ignore[no-untyped-def]
    """Assign one group; a row may also take a column of its own that costs nothing and means no pair."""
    n, m = len(rows), len(columns)
    cost = np.zeros((n, m + n), np.float64)
    for a in range(n):
        for b in range(m):
            vote = votes[rows[a], columns[b]]
            cost[a, b] = -vote if vote >= least else 1.0
    row_price, column_price = np.zeros(n, np.float64), np.zeros(m + n + 1, np.float64)
    owner = np.full(m + n + 1, -1, np.int64)  # row of each column; the last column is where a search starts
    before = np.empty(m + n, np.int64)
    for a in range(n):
        owner[m + n] = a
        column = m + n
        slack = np.full(m + n, np.inf)
        used = np.zeros(m + n + 1, np.bool_)
        while owner[column] >= 0:
            used[column] = True
            row, least_slack, following = owner[column], np.inf, -1
            for b in range(m + n):
                if not used[b]:
                    reduced = cost[row, b] - row_price[row] - column_price[b]
                    if reduced < slack[b]:
                        slack[b], before[b] = reduced, column
                    if slack[b] < least_slack:
                        least_slack, following = slack[b], b
            for b in range(m + n + 1):
                if used[b]:
                    row_price[owner[b]] += least_slack
                    column_price[b] -= least_slack
                elif b < m + n:
                    slack[b] -= least_slack
            column = following
        while column != m + n:
            owner[column] = owner[before[column]]
            column = before[column]
    for b in range(m):
        if owner[b] >= 0:
            chosen[rows[owner[b]]] = columns[b]

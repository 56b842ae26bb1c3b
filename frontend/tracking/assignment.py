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
    """Group by group: what is reached from a row over pairs with enough votes."""
    n, m = votes.shape
    chosen = np.full(n, -1, np.int32)
    row_ends, columns_of = _pairs(votes, least, row_seen, column_seen)
    column_ends, rows_of = _turned(row_ends, columns_of, m)
    rows, columns = np.empty(n, np.int64), np.empty(m, np.int64)
    for first in range(n):
        if row_seen[first]:
            continue
        rows[0], row_count, column_count, reached = first, 1, 0, 0
        row_seen[first] = True
        while reached < row_count:
            i = rows[reached]
            reached += 1
            for j in columns_of[row_ends[i] : row_ends[i + 1]]:
                if column_seen[j]:
                    continue
                column_seen[j] = True
                columns[column_count] = j
                column_count += 1
                for k in rows_of[column_ends[j] : column_ends[j + 1]]:
                    if not row_seen[k]:
                        row_seen[k] = True
                        rows[row_count] = k
                        row_count += 1
        if column_count:
            _solve(votes, least, rows[:row_count], columns[:column_count], chosen)
    return chosen


@njit()
def _pairs(votes, least, row_skipped, column_skipped):  # type: ignore[no-untyped-def]
    """Where the columns of each row end among (P,) columns of all pairs with enough votes, and these."""
    n, m = votes.shape
    ends = np.zeros(n + 1, np.int64)
    for i in range(n):
        count = 0
        if not row_skipped[i]:
            for j in range(m):  # without a branch, so that the compiler does eight at a time
                count += votes[i, j] >= least and not column_skipped[j]
        ends[i + 1] = ends[i] + count
    columns = np.empty(ends[n], np.int64)
    for i in range(n):
        place, end = ends[i], ends[i + 1]
        j = 0
        while place < end:
            if votes[i, j] >= least and not column_skipped[j]:
                columns[place] = j
                place += 1
            j += 1
    return ends, columns


@njit()
def _turned(row_ends, columns, count):  # type: ignore[no-untyped-def]
    """The same by column: where the rows of each of so many columns end, and the rows."""
    ends = np.zeros(count + 1, np.int64)
    for j in columns:
        ends[j + 1] += 1
    ends = np.cumsum(ends)
    rows, place = np.empty(len(columns), np.int64), ends[:-1].copy()
    for i in range(len(row_ends) - 1):
        for j in columns[row_ends[i] : row_ends[i + 1]]:
            rows[place[j]] = i
            place[j] += 1
    return ends, rows


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

"""Which right line is the partner of each left one: one to one by votes, and what looks like several left alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from frontend.tracking.assignment import assign

MIN_VOTE = 0.1
APART = 3.0  # px between disparities that are not one
SURE, SURE_ENOUGH = 0.8, 0.9  # a rival's share of the vote, below which a partner speaks for others, and is believed
NEAREST, REACH = 8, 0.05  # lines that speak for a disparity, and how much theirs may differ, as a share
LEAST = 3  # of them
MIN_ALONE, MOST = 0.35, 0.35  # votes that need nobody else, and the share that must agree with weaker ones

Float32 = NDArray[np.float32]


def choose(votes: Float32, disparities: Float32, middles: Float32, known: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The one-to-one pairs with the most votes, but for those in doubt.

    Lines with several candidates go by the disparities of the lines nearest by. A pair is in doubt if the line, or its
    partner, has a rival with nearly as many votes at another disparity, or if its own vote is weak and of the lines
    nearest by too few agree.

    Args:
        votes: (N, M), of `partner_votes`, with `disparities` (N, M, 2).
        middles: (N, 2) px, of the left lines.
        known: (N,) mask of those that had a partner in the last frame, which are in no doubt.

    Returns:
        (N,) int32 right line of each left one, or -1.
    """
    chosen = assign(votes, MIN_VOTE)
    sure = np.flatnonzero((chosen >= 0) & (known | (_rivals(votes, disparities, chosen) < SURE)))
    theirs = disparities[sure, chosen[sure]].mean(axis=1), middles[sure]
    raised = _supported(votes, disparities, middles, *theirs)
    chosen = assign(raised, MIN_VOTE)
    doubt = _rivals(raised, disparities, chosen) >= SURE_ENOUGH
    rows = np.flatnonzero(chosen >= 0)
    weak = rows[votes[rows, chosen[rows]] < MIN_ALONE]
    doubt[weak] |= ~agreeing(disparities[weak, chosen[weak]].mean(axis=1), middles[weak], *theirs)
    return np.where(doubt & ~known, -1, chosen).astype(np.int32)


@njit()
def agreeing(disparities, middles, sure, sure_middles):  # type: ignore[no-untyped-def]
    """(N,) mask of (N,) disparities at (N, 2) places that enough of the lines nearest by have, too.

    (S,) disparities `sure` belong to lines with middles `sure_middles` (S, 2).
    """
    agree, order, away = np.empty(len(middles), np.bool_), np.empty(NEAREST, np.int64), np.empty(NEAREST)
    for i in range(len(middles)):
        count = _nearest(middles[i], sure_middles, order, away)
        agree[i] = _agreement(disparities[i], sure, order, count) >= MOST * count
    return agree


@njit()
def _supported(votes, disparities, middles, sure, sure_middles):  # type: ignore[no-untyped-def]
    """(N, M) votes, raised where the lines nearest by have the same disparity; see `agreeing`."""
    raised = votes.copy()
    order, away = np.empty(NEAREST, np.int64), np.empty(NEAREST)
    for i in range(len(votes)):
        several = 0
        for j in range(votes.shape[1]):
            several += votes[i, j] > 0
        if several < 2:
            continue
        count = _nearest(middles[i], sure_middles, order, away)
        if count < LEAST:
            continue
        for j in range(votes.shape[1]):
            if votes[i, j] > 0:
                here = 0.5 * (disparities[i, j, 0] + disparities[i, j, 1])
                raised[i, j] *= 0.5 + min(_agreement(here, sure, order, count) / LEAST, 1.0)
    return raised


@njit()
def _nearest(middle, middles, order, away):  # type: ignore[no-untyped-def]
    """Fill in which lines are nearest to one, and how far, squared; returns how many."""
    count = 0
    for s in range(len(middles)):
        distance = (middles[s, 0] - middle[0]) ** 2 + (middles[s, 1] - middle[1]) ** 2
        if distance == 0 or (count == NEAREST and distance >= away[count - 1]):
            continue  # itself, or too far
        place = min(count, NEAREST - 1)
        count = min(count + 1, NEAREST)
        while place > 0 and away[place - 1] > distance:
            away[place], order[place] = away[place - 1], order[place - 1]
            place -= 1
        away[place], order[place] = distance, s
    return count


@njit()
def _agreement(disparity, sure, order, count):  # type: ignore[no-untyped-def]
    """How many of the nearest lines have that disparity."""
    agree = 0.0
    for n in range(count):
        theirs = sure[order[n]]
        agree += np.exp(-0.5 * ((disparity - theirs) / (2 + REACH * abs(theirs))) ** 2)
    return agree


@njit()
def _rivals(votes, disparities, chosen):  # type: ignore[no-untyped-def]
    """(N,) the best vote of the chosen pair's left or right line for another disparity, as a share of its own.

    1 for lines without a choice.
    """
    best, owner = np.zeros(len(votes)), np.full(votes.shape[1], -1)
    for i in range(len(votes)):
        if chosen[i] >= 0:
            owner[chosen[i]] = i
    for i in range(len(votes)):
        for j in range(votes.shape[1]):
            vote = votes[i, j]
            if vote <= 0:
                continue
            here = disparities[i, j, 0] + disparities[i, j, 1]
            for k in (i, owner[j]):  # whose line, or whose partner, this pair would take
                if k < 0 or vote <= best[k] or chosen[k] < 0:
                    continue
                if abs(disparities[k, chosen[k], 0] + disparities[k, chosen[k], 1] - here) > 2 * APART:
                    best[k] = vote
    share = np.ones(len(votes))
    for i in range(len(votes)):
        if chosen[i] >= 0:
            share[i] = best[i] / votes[i, chosen[i]]
    return share

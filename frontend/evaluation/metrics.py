"""How well a tracker keeps identities, from the records of its run over a clip.

A track is taken for the true line that its detection belongs to, or where it was measured that of what it observed;
those without an owner, or with an ambiguous one, count for nothing. Recall and IDF1 ask for detected lines alone, so
all figures are of the tracker and none of the detector.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from airline.errors import from_extra
from frontend.evaluation.truth import Record

with from_extra("evaluate"):
    from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]
Figures = dict[str, float | int | None]
ALIVE = (3, 5, 10)  # frames


def identity_scores(records: Sequence[Record]) -> Figures:
    """All figures of a run, as the command's JSON has them; None where nothing is there to be measured.

    Lengths are frames in which a track, or a true line, was seen; `alive_5` is the share of tracks seen in 5 or more. A
    fragment's frames are those of the track it is a piece of.
    """
    link, (switches, fragments) = links(records), changes(records)
    lengths, visible = track_lengths(records), _counts([record.detected for record in records])
    return {
        "link_precision": ratio(link.right, link.right + link.wrong),
        "link_recall": ratio(link.found, link.possible),
        "wrong_links": link.wrong,
        "idf1": idf1(records),
        "switches_per_100": ratio(100 * switches, len(records)),
        "fragments_per_100": ratio(100 * fragments, len(records)),
        "tracks": len(lengths),
        "track_length_mean": figure(np.mean, lengths),
        "track_length_median": figure(np.median, lengths),
        "visible_length_mean": figure(np.mean, visible),
        **{f"alive_{n}": figure(np.mean, lengths >= n) for n in ALIVE},
        "ms": figure(np.median, np.array([record.ms for record in records])),
    }


def figure(what: Callable[[Array], Any], values: NDArray[Any]) -> float | None:
    """A figure, such as `np.mean`, of the values that are not NaN, to four decimals; None without any."""
    known = values[~np.isnan(values)]
    return round(float(what(known)), 4) if len(known) else None


def rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def ratio(part: float, whole: float) -> float | None:
    """To four decimals; None of nothing."""
    return round(float(part / whole), 4) if whole else None


class Links(NamedTuple):
    """Counts of links: a track seen in two consecutive frames, with a known true line in both.

    Attributes:
        right: links whose true line is the same in both frames.
        wrong: the others.
        possible: true lines detected in two consecutive frames.
        found: those of them that a right link holds together.
    """

    right: int
    wrong: int
    possible: int
    found: int


def links(records: Sequence[Record]) -> Links:
    """Links between all consecutive frames."""
    right = wrong = possible = found = 0
    for before, after in pairwise(records):
        rows, later_rows = linked(before, after)
        first, second = before.owners[rows], after.owners[later_rows]
        known = (first >= 0) & (second >= 0)
        same = known & (first == second)
        right, wrong = right + int(same.sum()), wrong + int((known & ~same).sum())
        both = np.intersect1d(before.detected, after.detected, assume_unique=True)
        found += len(np.intersect1d(first[same], both))
        possible += len(both)
    return Links(right, wrong, possible, found)


def idf1(records: Sequence[Record]) -> float | None:
    """F-score of identities (Ristani et al. 2016): one track for each true line and one true line for each track.

    The truth is every pair of a frame and a true line detected in it; the answer every pair of a frame and a track with
    a known true line in it. Tracks are mapped to true lines one to one so that most pairs agree. Known fragments
    count as their track, once per frame; two tracks on pieces of one true line are two claims, one of them wrong.

    Returns:
        2 TP / (truth + answer) in [0, 1]; None where nothing is to be tracked.
    """
    truth = sum(len(record.detected) for record in records)
    claims = _claims(records)
    tracks, track = np.unique(claims[:, 1], return_inverse=True)
    lines, line = np.unique(claims[:, 2], return_inverse=True)
    together = np.zeros((len(tracks), len(lines)))
    np.add.at(together, (track, line), 1)
    agreed = together[linear_sum_assignment(together, maximize=True)].sum()
    return ratio(2 * agreed, truth + len(claims)) if truth else None


def _claims(records: Sequence[Record]) -> NDArray[np.int64]:
    """(K, 3) int64 frame, track and true line, where the line was detected; no two rows alike."""
    claims = [np.zeros((0, 3), np.int64)]
    for frame, record in enumerate(records):
        known = np.isin(record.owners, record.detected)
        pairs = np.stack([record.identities[known], record.owners[known]], axis=1)
        claims.append(np.unique(np.insert(pairs, 0, frame, axis=1), axis=0))
    return np.concatenate(claims)


def changes(records: Sequence[Record]) -> tuple[int, int]:
    """Changes of the main track of every true line: the last one if it still has the line, else the longest.

    Returns:
        Switches: another track than when the line was last tracked (the mismatches of Bernardin and Stiefelhagen 2008).
        Fragments: those of them where the line was not tracked in between.
    """
    last: dict[int, tuple[int, int]] = {}  # true line: track, frame
    switches = fragments = 0
    for index, record in enumerate(records):
        holders: dict[int, list[int]] = {}  # true line: its tracks, the longest first
        delta = record.tracked.segments_px[:, 1] - record.tracked.segments_px[:, 0]
        for row in np.argsort(-np.hypot(delta[:, 0], delta[:, 1]), kind="stable"):
            if record.owners[row] >= 0:
                holders.setdefault(int(record.owners[row]), []).append(int(record.identities[row]))
        for line, tracks in holders.items():
            track, seen = last.get(line, (tracks[0], index))
            if track not in tracks:
                switches, fragments = switches + 1, fragments + (seen < index - 1)
                track = tracks[0]
            last[line] = (track, index)
    return switches, fragments


def track_lengths(records: Sequence[Record]) -> NDArray[np.int64]:
    """(T,) int64 frames in which each track was seen, by id; what becomes a fragment counts as one throughout."""
    return _counts([np.unique(ids) for ids in whole_tracks(records)])


def whole_tracks(records: Sequence[Record]) -> list[NDArray[np.int64]]:
    """(N,) int64 ids of every frame's rows; what ever becomes a fragment has the id of the track it is a piece of."""
    whole = {
        track: parent
        for record in records
        for track, parent in zip(record.tracked.ids.tolist(), record.tracked.fragment_of.tolist(), strict=True)
        if parent >= 0
    }

    def root(track: int) -> int:
        while track in whole:
            track = whole[track]
        return track

    return [np.array([root(track) for track in record.tracked.ids.tolist()], np.int64) for record in records]


def linked(before: Record, after: Record) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of the tracks that are in both frames."""
    return np.intersect1d(before.tracked.ids, after.tracked.ids, assume_unique=True, return_indices=True)[1:]


def _counts(ids: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.unique(np.concatenate([np.zeros(0, np.int64), *ids]), return_counts=True)[1]

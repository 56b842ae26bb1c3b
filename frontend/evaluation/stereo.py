"""Lines of rectified pairs: are their partners right, and is what they tell of distances true?

Rendered pairs have a truth for every line; of clips with poses it is asked whether a line's place in space, from one
pair alone, is where later frames see it; of a camera at rest, how steady lengths and distances are.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.detector import AirLine
from airline.errors import InputError
from airline.evaluation.benchmark import lsd
from airline.image import to_uint8
from airline.lines import LineSet
from airline.scenes import RenderedClip, RenderedView
from frontend.evaluation.baselines import FlowTracker, end_errors, nearest_on_rows
from frontend.evaluation.metrics import Figures, figure, rms
from frontend.evaluation.posed import Posed
from frontend.evaluation.space import distances, image_lines
from frontend.evaluation.truth import AMBIGUOUS, Truth, longest_pieces, owners
from frontend.frame import Frame
from frontend.sources.scene import frame_of
from frontend.stereo.disparity import detection_errors, disparities, in_metres, own_covariances
from frontend.stereo.partners import PartnerFinder
from frontend.tracker import LineTracker
from frontend.tracks import LineTracks

FRAMES = 60  # of a rendered clip
LINE = 15.0  # px of a line in both images, and half of it, that make it visible in both
DISTANCES = (1, 2, 4, 8, 16)  # m, where groups of distances begin
MIN_FRAMES, MAX_ERROR = 5, 2.0  # of a track; px, of the line from its first pair in later frames
UPRIGHT = float(np.cos(np.deg2rad(15.0)))

Array = NDArray[np.float64]
Lines = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PairTruth:
    """What can be seen in both images of a pair.

    Attributes:
        left, right: the lines of each, with the same ids.
        disparities: (N, 2) float64 px, of the end points of the left one's pieces.
    """

    left: Truth
    right: Truth
    disparities: Array

    @classmethod
    def of(cls, left: RenderedView, right: RenderedView) -> PairTruth:
        """That of two rendered views."""
        offset = left.segments_world - left.pose[:3, 3]
        baseline = np.linalg.norm(right.pose[:3, 3] - left.pose[:3, 3])
        shift = left.K[0, 0] * baseline / (offset @ left.pose[:3, 2])
        return cls(Truth(left.segments_px, left.ids), Truth(right.segments_px, right.ids), shift)

    def visible(self, lines: Lines, own: NDArray[np.int64]) -> Mask:
        """(N,) mask of left lines whose true lines, where these lines are, can be seen in the right image.

        At least half of the line and 15 px of it must lie there on pieces of its true line.
        """
        rows = np.flatnonzero(own >= 0)
        pieces = longest_pieces(self.left, own[rows])
        start, shift = self.left.segments_px[pieces, 0].astype(np.float64), self.disparities[pieces]
        delta = self.left.segments_px[pieces, 1] - start
        # Disparity is linear along a line's image.
        along = np.einsum("nec,nc->ne", lines[rows] - start[:, None], delta) / (delta**2).sum(axis=1)[:, None]
        there = start[:, None] + along[:, :, None] * delta[:, None]
        there[:, :, 0] -= shift[:, :1] + along * (shift[:, 1:] - shift[:, :1])
        found = np.zeros(len(lines), np.bool_)
        for row, (first, last) in zip(rows, there, strict=True):
            length = float(np.hypot(*(last - first)))
            parts = self.right.segments_px[self.right.ids == own[row]] - first
            low, high = np.sort(parts @ (last - first) / max(length, 1e-9), axis=1).T
            cover = np.maximum(np.minimum(high, length) - np.maximum(low, 0), 0).sum()
            found[row] = cover >= max(LINE, length / 2)
        return found


@dataclass(frozen=True)
class Pairs:
    """A tracker's lines in one pair and their partners; rows of the same track.

    Attributes:
        ids: (N,) int64 of tracks.
        left, right: (N, 2, 2) float32 px, as observed; NaN without a partner.
        disparity, covariances, known, points: as `disparity_px`, `disparity_covariances`, `depth_known` and
            `segments_m` of `LineTracks`.
        ms: time of the matching.
    """

    ids: NDArray[np.int64]
    left: Lines
    right: Lines
    disparity: Lines
    covariances: Lines
    known: Mask
    points: Lines
    ms: float


class Ours:
    """The tracker, and partners of its tracks."""

    def __init__(self, detect: AirLine) -> None:
        self._detect, self._tracker, self._partners = detect, LineTracker(), PartnerFinder()

    def __call__(self, frame: Frame) -> Pairs:
        """Take the next pair."""
        assert frame.right is not None
        left, right = self._detect.trace(frame.image), self._detect.trace(frame.right)
        tracks, begun = self._tracker.update(frame, left.lines, left.edges), time.perf_counter()
        return pairs_of(self._partners.update(tracks, frame, right), 1e3 * (time.perf_counter() - begun))


def pairs_of(tracks: LineTracks, ms: float = 0.0) -> Pairs:
    """What is evaluated of tracks in a pair; raises InputError without a baseline."""
    known, covariances, points = tracks.depth_known, tracks.disparity_covariances, tracks.segments_m
    if tracks.disparity_px is None or covariances is None or known is None or points is None:
        raise InputError("the frames are no pairs of a calibrated stereo camera")
    lines = tracks.observed_px, tracks.right_px
    return Pairs(tracks.ids, *lines, tracks.disparity_px, covariances, known, points, ms)


class Plain:
    """LSD (Grompone von Gioi et al. 2010) in both images, tracks by optical flow, partners by `nearest_on_rows`.

    Variances are those of end points good to 0.3 px.
    """

    def __init__(self) -> None:
        self._lsd, self._tracker = lsd(), FlowTracker()

    def __call__(self, frame: Frame) -> Pairs:
        """Take the next pair."""
        assert frame.right_gray is not None
        assert frame.camera is not None
        gray, right_gray = to_uint8(frame.gray), to_uint8(frame.right_gray)
        found, others = (self._lsd(image).astype(np.float32) for image in (gray, right_gray))
        none = np.zeros((len(found), 0), np.float32)
        tracked = self._tracker.update(frame, LineSet(found, np.ones(len(found), np.float32), none))
        lines, begun = tracked.segments_px, time.perf_counter()
        partner = nearest_on_rows(lines, others, gray, right_gray)
        ms = 1e3 * (time.perf_counter() - begun)
        right = np.append(others, np.full((1, 2, 2), np.nan, np.float32), axis=0)[partner]
        turned = np.einsum("nc,nc->n", lines[:, 1] - lines[:, 0], right[:, 1] - right[:, 0]) < 0
        right[turned] = right[turned, ::-1]
        errors = end_errors(lines)
        spread = detection_errors(lines, errors, right, end_errors(right))
        both = lines, errors, right, errors + own_covariances(lines, right, spread)
        disparity, covariances, known = disparities(*both, frame.camera.disparity_offset)
        points, _ = in_metres(*both, known, frame.camera)
        return Pairs(tracked.ids, lines, right, disparity, covariances, known, points, ms)


def rendered_pairs() -> dict[str, RenderedClip]:
    """The rendered clips with a second camera, 640x480; their truth has every line a detector might see."""
    scenes = {"room": ("indoor", 3), "corridor": ("indoor", 12), "street": ("street", 5), "houses": ("street", 6)}
    scenes["shelves"] = ("shelves", 4)
    return {
        name: RenderedClip(kind, "handheld", seed, FRAMES, min_contrast=1.0, merge_doubles=False)
        for name, (kind, seed) in scenes.items()
    }


def follow(frames: Iterable[Frame], detect: AirLine, done: Callable[[], None]) -> dict[str, list[Pairs]]:
    """What every tracker makes of pairs; `done` is called after each. Raises InputError: one cannot be read."""
    trackers: dict[str, Callable[[Frame], Pairs]] = {"ours": Ours(detect), "plain": Plain()}
    runs: dict[str, list[Pairs]] = {name: [] for name in trackers}
    for frame in frames:
        for name, tracker in trackers.items():
            runs[name].append(tracker(frame))
        done()
    return runs


def frames_of(clip: RenderedClip, limit: int | None, truths: list[PairTruth]) -> Iterator[Frame]:
    """The first pairs of a clip, rendered in the caller's thread; their truth is appended to `truths`."""
    for i in range(min(len(clip), limit or len(clip))):
        left, right = clip.render(i), clip.render(i, right=True)
        truths.append(PairTruth.of(left, right))
        yield frame_of(i, left, right)


def partner_scores(run: Sequence[Pairs], truths: Sequence[PairTruth]) -> dict[str, Any]:
    """Figures of a run over pairs with truth, None without anything to count.

    Returns:
        as `report.STEREO_LEGEND` says, shares in [0, 1]; visible: how many lines can be seen in both images; depth: by
        true distance, m, the median error over it and the number of ends; ms: median time of matching.
    """
    judged = [_judged(pairs, truth) for pairs, truth in zip(run, truths, strict=True)]
    rows = {name: np.concatenate([one[name] for one in judged]) for name in judged[0]}
    has, known, right, depth = rows["has"], rows["known"], rows["right"], rows["depth"]
    seen, sure = rows["seen"] & ~(has & ~known), right & depth
    error, square, ratio = rows["error"][sure], rows["square"][sure], rows["ratio"][sure]
    group = np.digitize(rows["distance"][sure], DISTANCES) - 1
    return {
        "partners": int(has.sum()),
        "precision": figure(np.mean, right[known]),
        "wrong": int((known & ~right).sum()),
        "unknown": int((has & ~known).sum()),
        "visible": int(seen.sum()),
        "recall": figure(np.mean, right[seen]),
        "depth_known": figure(np.mean, depth[has]),
        "along_rows": figure(np.mean, rows["flat"][has]),
        "disparity_rms_px": figure(rms, error.ravel()),
        "disparity_median_px": figure(np.median, np.abs(error).ravel()),
        "chi2": figure(np.mean, square / 2),
        "ms": figure(np.median, np.array([pairs.ms for pairs in run])),
        "depth": {
            f"{low}": {"error": figure(np.median, np.abs(ratio[group == k] - 1)), "ends": int((group == k).sum())}
            for k, low in enumerate(DISTANCES)
        },
    }


def _judged(pairs: Pairs, truth: PairTruth) -> dict[str, NDArray[Any]]:
    """(N,) masks of the rows of `pairs`; and errors of both ends, px, their squares over variances, distances."""
    has: Mask = np.asarray(np.isfinite(pairs.right).all(axis=(1, 2)))
    own, other = owners(pairs.left, truth.left), np.full(len(has), AMBIGUOUS)
    other[has] = owners(pairs.right[has], truth.right)
    right = has & (own >= 0) & (own == other)
    true = np.full((len(has), 2), np.nan)
    true[right] = _true_disparities(pairs.left[right], own[right], truth)
    error, sure = pairs.disparity - true, right & pairs.known
    square = np.full(len(has), np.nan)
    weighed = np.linalg.solve(pairs.covariances[sure].astype(np.float64), error[sure][:, :, None])
    square[sure] = (error[sure] * weighed[:, :, 0]).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = true / pairs.disparity  # of distances; points at infinity have no disparity in these clips
    return {
        "has": has,
        "known": has & (own >= 0) & (other >= 0),
        "right": right,
        "seen": truth.visible(pairs.left, own),
        "depth": pairs.known,
        "flat": has & np.isnan(pairs.disparity).any(axis=1),
        "error": error,
        "square": square,
        "ratio": ratio,
        "distance": pairs.points[:, :, 2] / ratio,
    }


def _true_disparities(lines: Lines, own: NDArray[np.int64], truth: PairTruth) -> Array:
    """(N, 2) px, of true lines in the rows of the lines' end points."""
    x = []
    for view in (truth.left, truth.right):
        pieces = view.segments_px[longest_pieces(view, own)].astype(np.float64)
        start, delta = pieces[:, 0], pieces[:, 1] - pieces[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):  # along the rows
            x.append(start[:, :1] + (lines[:, :, 1] - start[:, 1:]) * (delta[:, :1] / delta[:, 1:]))
    return np.asarray(x[0] - x[1])


def first_pair_scores(run: Sequence[Pairs], clip: Posed) -> Figures:
    """Are lines in space, as the first pair of a track tells them, where later frames see them?

    Args:
        run: a tracker's answers.
        clip: the left camera's poses in these frames, and maybe more.

    Returns:
        of: tracks seen in 5 frames and more; tracks: those of them of which the first frame tells the depth; the others
        as `report.STEREO_LEGEND` says. ms: median time of matching.
    """
    seen: dict[int, list[tuple[int, int]]] = {}  # frame and row of every observation
    for frame, pairs in enumerate(run):
        for row, track in enumerate(pairs.ids.tolist()):
            seen.setdefault(track, []).append((frame, row))
    worst, median, long = [], [], [places for places in seen.values() if len(places) >= MIN_FRAMES]
    for (frame, row), *later in long:
        if run[frame].known[row]:
            start, end = run[frame].points[row] @ clip.poses[frame, :, :3].T + clip.poses[frame, :, 3]
            line = image_lines(clip.poses[[k for k, _ in later]], np.stack([start, end - start]), clip.K)
            errors = distances(np.array([run[k].left[other] for k, other in later], np.float64), line).max(axis=1)
            worst.append(errors.max())
            median.append(np.median(errors))
    always: Mask = np.array(worst) <= MAX_ERROR
    usually: Mask = np.array(median) <= MAX_ERROR
    return {
        "of": len(long),
        "tracks": len(always),
        "always": int(always.sum()),
        "always_share": figure(np.mean, always),
        "usually": int(usually.sum()),
        "usually_share": figure(np.mean, usually),
        "ms": figure(np.median, np.array([pairs.ms for pairs in run])),
    }


def rest_scores(run: Sequence[Pairs]) -> Figures:
    """How steady upright lines (15 degrees from the columns) are in space while the camera rests.

    Returns:
        as `report.STEREO_LEGEND` says, m, and spreads over these. ms: median time of matching.
    """
    measures: dict[int, list[tuple[float, float]]] = {}
    for pairs in run:
        delta = pairs.left[:, 1] - pairs.left[:, 0]
        upright = np.abs(delta[:, 1]) >= UPRIGHT * np.hypot(*delta.T)
        for row in np.flatnonzero(upright & pairs.known):
            first, last = pairs.points[row]
            measure = float(np.linalg.norm(last - first)), float(first[2] + last[2]) / 2
            measures.setdefault(int(pairs.ids[row]), []).append(measure)
    long = [np.array(values) for values in measures.values() if 2 * len(values) >= len(run)]
    middles = np.array([np.median(values, axis=0) for values in long]).reshape(-1, 2)
    spreads = [1.4826 * np.median(np.abs(values - at), axis=0) / at for values, at in zip(long, middles, strict=True)]
    length, depth = middles.T
    length_spread, depth_spread = np.array(spreads).reshape(-1, 2).T
    return {
        "tracks": len(long),
        "length_m": figure(np.median, length),
        "length_spread": figure(np.median, length_spread),
        "depth_m": figure(np.median, depth),
        "depth_spread": figure(np.median, depth_spread),
        "ms": figure(np.median, np.array([pairs.ms for pairs in run])),
    }

"""The partners of tracked lines in the right image of a rectified pair."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from airline.image import to_uint8
from airline.trace import Trace
from frontend.frame import Frame
from frontend.stereo.alignment import aligned
from frontend.stereo.choice import APART, NEAREST, agreeing, choose
from frontend.stereo.votes import partner_votes
from frontend.tracking.appearance import side_profiles
from frontend.tracking.guided import MAX_BAND, SHORTEST, measure
from frontend.tracking.measurement import MEASURED, line_covariances, with_bias
from frontend.tracking.overlap import LineFeatures, covered
from frontend.tracking.prediction import camera_of
from frontend.tracking.seen import runs_backwards
from frontend.tracks import LineTracks

WIDEST = 0.35  # of the image's width, of disparities
BEYOND = 2.0  # px past infinity that errors may take a disparity
SLACK, CHANGE = 3.0, 0.15  # px, and share of a disparity, by which it may differ from the last frame's
MIN_SUPPORT, MIN_APPEARANCE = 0.6, 0.5  # of a partner on the edge map, as of `TrackerConfig`;
MIN_GUESSED, YOUNG = 0.6, 1  # the latter where the disparity is guessed, which it is up to this age
LEAST_SIDE = 3  # px of an image
LEAST = 10  # partners that tell which camera is the left one

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Partners:
    """What is known of N tracks' partners; filled step by step.

    Attributes:
        segments: (N, 2, 2) float32 px, NaN where there is none, with `errors` (N, 2, 2) float32.
        spans: (N, 2) px, least and most disparity along the line, in the last frame until it is known in this one; NaN
            where it had none.
        measured: (N,) not detected.
    """

    segments: NDArray[np.float32]
    errors: NDArray[np.float32]
    spans: Array
    measured: NDArray[np.bool_]

    @property
    def found(self) -> NDArray[np.bool_]:
        """(N,) mask of those that have one."""
        mask: NDArray[np.bool_] = ~np.isnan(self.segments[:, 0, 0])
        return mask


class PartnerFinder:
    """Finds the tracks' lines in the right images of a stream.

    As in time, a line is predicted (its last disparity), laid over the lines there, and paired one to one by votes; a
    track without a last disparity is looked for along its rows. Lines without a partner are measured on the edge map,
    where they were, or in their first frames where the lines beside them are. Then all are aligned to fractions of a
    pixel.
    """

    def __init__(self) -> None:
        self._ids, self._hits, self._spans = np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros((0, 2))
        self._sides_known = False

    def update(self, tracks: LineTracks, frame: Frame, right: Trace) -> LineTracks:
        """The tracks of a frame with their partners.

        Args:
            tracks: N tracks of the left image, `ids` ascending.
            frame: it, with its right image.
            right: the detector's results for that one.

        Raises:
            InputError: there is no right image of the same size, or the cameras are the wrong way round.
        """
        size = frame.gray.shape
        if frame.right_gray is None or frame.right_gray.shape != size or min(size) < LEAST_SIDE:
            raise InputError(
                f"partners are looked for in a right image of the left one's size, {LEAST_SIDE} px wide and high at "
                "least: give Frame.right"
            )
        images, lines = (to_uint8(frame.gray), to_uint8(frame.right_gray)), right.lines
        if not np.isfinite(lines.segments).all() or right.edges.shape != images[1].shape:
            raise InputError("the right image's lines must be finite, and its edges of its size")
        camera = camera_of(tracks.camera, images[0].shape[::-1])
        gain, infinity = _gain(*images), camera.disparity_offset
        hits, partners = self._remembered(tracks.ids)
        ours = LineFeatures(tracks.observed_px, tracks.descriptors, side_profiles(images[0], tracks.observed_px))
        theirs = LineFeatures(lines.segments, lines.descriptors, side_profiles(images[1], lines.segments))

        ranges = self._ranges(partners.spans, infinity, camera.width)
        votes, spans = partner_votes(images, (ours, theirs), ranges, gain)
        chosen = choose(votes, spans, ours.segments.mean(axis=1), ~np.isnan(partners.spans[:, 0]))
        rows = np.flatnonzero(chosen >= 0)
        self._check_sides(spans[rows, chosen[rows]].mean(axis=1) - infinity)
        segments = lines.segments[chosen[rows]].copy()
        back = runs_backwards(ours.segments[rows], segments)
        segments[back] = segments[back, ::-1]
        partners.segments[rows] = segments
        partners.errors[rows] = line_covariances(
            segments, None if lines.residuals is None else lines.residuals[chosen[rows]]
        )
        partners.spans[rows] = np.sort(spans[rows, chosen[rows]], axis=1)
        _measure(partners, ours, tracks.ages <= YOUNG, right.edges, images[1])
        left = tracks.observed_px, tracks.observed_covariances
        errors = with_bias(partners.errors, np.zeros(len(tracks), np.float32))
        segments, errors, ends = aligned(images, gain, left, (partners.segments, errors), camera)
        spans = np.where(np.isnan(ends), partners.spans, np.sort(ends, axis=1))
        hits = np.where(partners.found, hits + 1, 0).astype(np.int32)
        self._ids, self._hits, self._spans = tracks.ids, hits, np.where(partners.found[:, None], spans, np.nan)
        return replace(
            tracks, right_px=segments, right_covariances=errors, right_hits=hits, right_measured=partners.measured
        )

    def _remembered(self, ids: NDArray[np.int64]) -> tuple[NDArray[np.int32], _Partners]:
        """(N,) hits of tracks, and their partners as far as they are predicted."""
        count = len(ids)
        segments, errors = np.full((2, count, 2, 2), np.nan, np.float32)
        partners = _Partners(segments, errors, np.full((count, 2), np.nan), np.zeros(count, np.bool_))
        hits = np.zeros(count, np.int32)
        _, rows, places = np.intersect1d(ids, self._ids, assume_unique=True, return_indices=True)
        hits[rows], partners.spans[rows] = self._hits[places], self._spans[places]
        return hits, partners

    def _ranges(self, spans: Array, infinity: float, width: int) -> Array:
        """(N, 2) px, least and most disparity of each track."""
        slack = SLACK + CHANGE * np.abs(spans - infinity)
        most = WIDEST * width
        least = BEYOND if self._sides_known else most
        return np.where(np.isnan(spans), (infinity - least, infinity + most), spans + slack * (-1, 1))

    def _check_sides(self, disparities: NDArray[np.float32]) -> None:
        """Refuse cameras that are the wrong way round, by the first (N,) disparities from infinity that tell, px."""
        if self._sides_known:
            return
        left, right = (disparities < -BEYOND).sum(), (disparities > BEYOND).sum()
        if left > max(LEAST, right):
            raise InputError(
                "the cameras are the wrong way round, what the right one sees lies to the right: swap left and right"
            )
        self._sides_known = right > LEAST


def _measure(
    partners: _Partners,
    ours: LineFeatures,
    young: NDArray[np.bool_],
    edges: NDArray[np.float32],
    gray: NDArray[np.uint8],
) -> None:
    """Look for lines without a partner on the edge map, see `frontend.tracking.guided`."""
    rows, guesses = _guesses(partners, ours.segments.mean(axis=1), young)
    predicted = ours.segments[rows].copy()
    predicted[..., 0] -= guesses[:, None]
    segments, residuals, support, _ = measure(edges, predicted, np.full(len(rows), MAX_BAND, np.float32))
    alike = (side_profiles(gray, segments) * ours.profiles[rows]).sum(axis=1)
    good = (support >= MIN_SUPPORT) & (np.hypot(*(segments[:, 1] - segments[:, 0]).T) >= SHORTEST)
    good &= alike >= np.where(np.isnan(partners.spans[rows, 0]), MIN_GUESSED, MIN_APPEARANCE)
    good[good] = ~covered(segments[good], partners.segments[partners.found])
    best = np.flatnonzero(good)
    best = best[np.lexsort((-alike[best], rows[best]))]
    best = best[np.unique(rows[best], return_index=True)[1]]
    rows, guesses = rows[best], guesses[best]
    partners.segments[rows] = segments[best]
    partners.errors[rows] = line_covariances(segments[best], residuals[best], MEASURED)
    partners.spans[rows] = np.where(np.isnan(partners.spans[rows]), guesses[:, None], partners.spans[rows])
    partners.measured[rows] = True


def _guesses(
    partners: _Partners, middles: NDArray[np.float32], young: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Rows of lines without a partner, some of them several times, and disparities that they may have, px."""
    found, middle = partners.found, partners.spans.mean(axis=1)
    missed, new = np.flatnonzero(~found & ~np.isnan(middle)), np.flatnonzero(~found & np.isnan(middle) & young)
    away = np.linalg.norm(middles[new, None] - middles[found], axis=2)
    near = np.sort(middle[found][np.argsort(away, axis=1, kind="stable")[:, :NEAREST]], axis=1)
    another = np.diff(near, axis=1, prepend=-np.inf) > APART
    rows = np.repeat(new, another.sum(axis=1))
    likely = agreeing(near[another], middles[rows], middle[found], middles[found])
    rows = np.concatenate([missed, rows[likely]])
    return rows, np.concatenate([middle[missed], near[another][likely]]).astype(np.float32)


def _gain(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[float, float]:
    """By which right grey levels become left ones, and what is added: cameras expose as they like."""
    ours, theirs = left[::16, ::16], right[::16, ::16]
    gain = float(np.clip((ours.std() + 1) / (theirs.std() + 1), 0.5, 2))
    return gain, float(ours.mean() - gain * theirs.mean())

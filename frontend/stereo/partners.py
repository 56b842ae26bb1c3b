"""The partners of tracked lines in the right image of a rectified pair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from airline.image import to_uint8
from airline.trace import Trace
from frontend.frame import Frame
from frontend.stereo.votes import partner_votes, rivals, supported
from frontend.tracking.appearance import side_profiles
from frontend.tracking.assignment import assign
from frontend.tracking.guided import MAX_BAND, SHORTEST, measure
from frontend.tracking.measurement import MEASURED, line_covariances, with_bias
from frontend.tracking.overlap import LineFeatures, covered
from frontend.tracking.seen import runs_backwards
from frontend.tracks import LineTracks

WIDEST = 0.35  # of the image's width, of disparities
BEYOND = 2.0  # px past infinity that errors may take a disparity
MIN_VOTE = 0.1
APART = 3.0  # px between disparities that are not one
SURE, SURE_ENOUGH = 0.8, 0.9  # a rival's share of the vote, below which a partner speaks for others, and is believed
NEAREST, REACH = 8, 0.05  # lines that speak for a disparity, and how much theirs may differ, as a share
SLACK, CHANGE = 3.0, 0.15  # px, and share of a disparity, by which it may differ from the last frame's
MIN_SUPPORT, MIN_APPEARANCE = 0.6, 0.5  # of a partner on the edge map, as of `TrackerConfig`
LEAST = 10  # partners that tell which camera is the left one

Array = NDArray[np.float64]


class PartnerFinder:
    """Finds the tracks' lines in the right images of a stream.

    As in time, a line is predicted (its last disparity), laid over the lines there, and paired one to one by votes; a
    track without a last disparity is looked for along its rows, and what looks like several is decided by the lines
    beside it, or left alone. Lines that were predicted and not detected are measured on the edge map.
    """

    def __init__(self) -> None:
        self._ids, self._hits = np.zeros(0, np.int64), np.zeros(0, np.int32)
        self._last = np.zeros((0, 2))  # px, least and most disparity along each line when it last had a partner
        self._sides_known = False

    def update(self, tracks: LineTracks, frame: Frame, right: Trace) -> LineTracks:
        """The tracks of a frame with their partners.

        Args:
            tracks: N tracks of the left image, `ids` ascending.
            frame: it, with its right image.
            right: the detector's results for that one.

        Raises:
            InputError: the cameras are the wrong way round.
        """
        assert frame.right_gray is not None
        images = to_uint8(frame.gray), to_uint8(frame.right_gray)
        infinity = 0.0 if tracks.camera is None else tracks.camera.disparity_offset
        last, hits = self._remembered(tracks.ids)
        ranges = self._ranges(last, infinity, images[0].shape[1])
        ours = LineFeatures(tracks.observed_px, tracks.descriptors, side_profiles(images[0], tracks.observed_px))
        segments = right.lines.segments
        theirs = LineFeatures(segments, right.lines.descriptors, side_profiles(images[1], segments))
        votes, disparities = partner_votes(images, (ours, theirs), ranges, _gain(*images))
        chosen = _chosen(votes, disparities, ours.segments, ~np.isnan(last[:, 0]))
        self._check_sides(disparities[np.arange(len(chosen)), chosen][chosen >= 0] - infinity)
        found, errors = (
            np.full((len(tracks), 2, 2), np.nan, np.float32),
            np.full((len(tracks), 2, 2), np.nan, np.float32),
        )
        hit = chosen >= 0
        lines = right.lines.segments[chosen[hit]].copy()
        back = runs_backwards(ours.segments[hit], lines)
        lines[back] = lines[back, ::-1]
        residuals = None if right.lines.residuals is None else right.lines.residuals[chosen[hit]]
        found[hit], errors[hit] = lines, line_covariances(lines, residuals)
        last[hit] = np.sort(disparities[hit, chosen[hit]], axis=1)
        measured = self._measure(ours, last, found, errors, right, images[1])
        hit |= measured
        errors = with_bias(errors, np.zeros(len(errors), np.float32))
        hits = np.where(hit, hits + 1, 0).astype(np.int32)
        self._ids, self._last, self._hits = tracks.ids, np.where(hit[:, None], last, np.nan), hits
        return replace(tracks, right_px=found, right_covariances=errors, right_hits=hits, right_measured=measured)

    def _remembered(self, ids: NDArray[np.int64]) -> tuple[Array, NDArray[np.int32]]:
        """(N, 2) last disparities, NaN where there are none, and (N,) hits of tracks."""
        place = np.minimum(np.searchsorted(self._ids, ids), max(len(self._ids) - 1, 0))
        known = self._ids[place] == ids if len(self._ids) else np.zeros(len(ids), np.bool_)
        last, hits = np.full((len(ids), 2), np.nan), np.zeros(len(ids), np.int32)
        last[known], hits[known] = self._last[place[known]], self._hits[place[known]]
        return last, hits

    def _ranges(self, last: Array, infinity: float, width: int) -> Array:
        """(N, 2) px, least and most disparity of each track."""
        slack = SLACK + CHANGE * np.abs(last - infinity)
        most = WIDEST * width
        least = BEYOND if self._sides_known else most
        return np.where(np.isnan(last), (infinity - least, infinity + most), last + slack * (-1, 1))

    def _check_sides(self, disparities: NDArray[np.float32]) -> None:
        if self._sides_known or len(disparities) < LEAST:
            return
        middle = disparities.mean(axis=1)
        if (middle < -BEYOND).sum() > max(LEAST, (middle > BEYOND).sum()):
            raise InputError(
                "the cameras are the wrong way round, what the right one sees lies to the right: swap left and right"
            )
        self._sides_known = (middle > BEYOND).sum() > LEAST

    def _measure(
        self,
        ours: LineFeatures,
        last: Array,
        found: NDArray[np.float32],
        errors: NDArray[np.float32],
        right: Trace,
        gray: NDArray[np.uint8],
    ) -> NDArray[np.bool_]:
        """Look for predicted lines without a partner on the edge map; returns the (N,) mask of those found."""
        rows = np.flatnonzero(np.isnan(found[:, 0, 0]) & ~np.isnan(last[:, 0]))
        predicted = ours.segments[rows] - np.stack([last[rows].mean(axis=1), np.zeros(len(rows))], axis=1)[:, None]
        predicted = predicted.astype(np.float32)
        bands = np.full(len(rows), MAX_BAND, np.float32)
        segments, residuals, support, _ = measure(right.edges, predicted, bands)
        length = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
        profiles = side_profiles(gray, segments)
        good = (support >= MIN_SUPPORT) & (length >= SHORTEST)
        good &= (profiles * ours.profiles[rows]).sum(axis=1) >= MIN_APPEARANCE
        taken = found[~np.isnan(found[:, 0, 0])]
        good[good] = ~covered(segments[good], taken)
        found[rows[good]], errors[rows[good]] = segments[good], line_covariances(segments, residuals, MEASURED)[good]
        measured = np.zeros(len(found), np.bool_)
        measured[rows[good]] = True
        return measured


def _gain(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[float, float]:
    """By which right grey levels become left ones, and what is added: cameras expose as they like."""
    ours, theirs = left[::8, ::8], right[::8, ::8]
    gain = float(np.clip((ours.std() + 1) / (theirs.std() + 1), 0.5, 2))
    return gain, float(ours.mean() - gain * theirs.mean())


def _chosen(
    votes: NDArray[np.float32],
    disparities: NDArray[np.float32],
    segments: NDArray[np.float32],
    known: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(N,) the partner of each line, or -1.

    Args:
        votes, disparities: of `partner_votes`.
        segments: (N, 2, 2) the left lines.
        known: (N,) mask of those that had a partner in the last frame, which are not in doubt.
    """
    chosen, middles = assign(votes, MIN_VOTE), segments.mean(axis=1)
    sure = np.flatnonzero((chosen >= 0) & (known | (rivals(votes, disparities, chosen, APART) < SURE)))
    theirs = disparities[sure, chosen[sure]].mean(axis=1)
    raised = supported(votes, disparities, middles, theirs, middles[sure], NEAREST, REACH)
    chosen = assign(raised, MIN_VOTE)
    doubt = ~known & (rivals(raised, disparities, chosen, APART) >= SURE_ENOUGH)
    return np.where(doubt, -1, chosen).astype(np.int32)

"""What cameras saw of tracked lines, and of points beside them, on the plane z = 1 without the lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from frontend import LineTracks

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
TINY = 1e-12


@dataclass(frozen=True)
class Lines:
    """Observed lines.

    Attributes:
        ids: (N,) tracks; one may be there twice, as pieces of a broken line.
        ends: (N, 2, 2) end points.
        lines: (N, 3) a, b, c: a u + b v + c is the distance of (u, v) from the line.
        variances: (N, 2) of the line's offset at its middle, and of its angle, radians.
    """

    ids: Ids
    ends: Array
    lines: Array
    variances: Array


@dataclass(frozen=True)
class Points:
    """Observed points: (P,) tracks, and (P, 2) where they are."""

    ids: Ids
    places: Array


@dataclass(frozen=True)
class View:
    """What one camera saw of a frame."""

    lines: Lines
    points: Points

    @staticmethod
    def of(tracks: LineTracks) -> View:
        """What the frontend says of a frame whose camera is known; a piece of a broken line is that line.

        Raises:
            ValueError: no camera.
        """
        ends, lines = tracks.observed_normalized, tracks.observed_lines
        covariances, points = tracks.observed_line_covariances, tracks.points_normalized
        if ends is None or lines is None or covariances is None or points is None:
            raise ValueError("odometry needs a camera: give the source a calibration")
        ids = np.where(tracks.fragment_of >= 0, tracks.fragment_of, tracks.ids)
        seen = Lines(ids, *(np.float64(values) for values in (ends, lines, np.einsum("nii->ni", covariances))))
        known = np.isfinite(seen.ends).all(axis=(1, 2)) & np.isfinite(seen.variances).all(axis=1)
        there = np.isfinite(points).all(axis=1)
        return View(take(seen, known), take(Points(tracks.point_ids, np.float64(points)), there))

    @staticmethod
    def pair_of(tracks: LineTracks) -> tuple[View, View]:
        """What both cameras of a rectified pair saw, each on its own plane z = 1; no points on the right."""
        there = tracks.take(np.flatnonzero(tracks.right_hits))
        infinity = 0.0 if there.camera is None else there.camera.disparity_offset
        right = replace(
            there,
            observed_px=there.right_px + np.array((infinity, 0), np.float32),
            observed_covariances=there.right_covariances,
            point_ids=there.point_ids[:0],
            points_px=there.points_px[:0],
        )
        return View.of(tracks), View.of(right)


def both_cameras(poses: Array, baseline_m: float) -> Array:
    """(2 K, 3, 4) the poses of left, right, left, ... cameras from the left ones' (K, 3, 4); these where it is 0."""
    if not baseline_m:
        return poses
    right = poses.copy()
    right[:, :, 3] += baseline_m * poses[:, :, 0]
    return np.stack([poses, right], axis=1).reshape(-1, 3, 4)


Seen = TypeVar("Seen", Lines, Points)


@dataclass(frozen=True)
class Observations(Generic[Seen]):
    """Lines, or points, in several views, ordered by their track.

    Attributes:
        ids: (N,) tracks, ascending; row k is track k.
        row: (M,) that of each observation's track, ascending.
        view: (M,) number of its view.
        seen: the M observations.
    """

    ids: Ids
    row: NDArray[np.intp]
    view: NDArray[np.intp]
    seen: Seen

    @cached_property
    def starts(self) -> NDArray[np.intp]:
        """(N,) first observation of each track."""
        return np.searchsorted(self.row, np.arange(len(self.ids)))

    @cached_property
    def counts(self) -> NDArray[np.intp]:
        """(N,) number of observations of each track."""
        return np.bincount(self.row, minlength=len(self.ids))

    def sums(self, values: Array) -> Array:
        """(N, ...) sums over each track's observations of values (M, ...)."""
        return np.add.reduceat(values, self.starts) if len(self.ids) else np.zeros((0, *values.shape[1:]))

    def only(self, keep: NDArray[np.bool_]) -> Observations[Seen]:
        """The observations of the tracks (N,) to keep."""
        rows = np.flatnonzero(keep[self.row])
        return Observations(
            self.ids[keep], (np.cumsum(keep) - 1)[self.row[rows]], self.view[rows], take(self.seen, rows)
        )


def gather(views: Sequence[Seen], least: int, ids: Ids | None = None) -> Observations[Seen]:
    """What was observed at least so many times, of all tracks or of the given ones."""
    names = [field.name for field in fields(views[0])]
    every = type(views[0])(*(np.concatenate([getattr(view, name) for view in views]) for name in names))
    place = np.repeat(np.arange(len(views)), [len(view.ids) for view in views])
    wanted = np.flatnonzero(np.isin(every.ids, ids)) if ids is not None else np.arange(len(every.ids))
    order = wanted[np.argsort(every.ids[wanted], kind="stable")]
    found, row, counts = np.unique(every.ids[order], return_inverse=True, return_counts=True)
    return Observations(found, row, place[order], take(every, order)).only(counts >= least)


def take(seen: Seen, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Seen:
    """Some of the lines or points."""
    return type(seen)(*(getattr(seen, field.name)[rows] for field in fields(seen)))

"""What a camera saw of tracked lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from frontend import LineTracks
from line_odometry.geometry import Array, distances, homogeneous, image_lines

Ids = NDArray[np.int64]


@dataclass(frozen=True)
class View:
    """The lines of one frame.

    Attributes:
        ids: (N,) tracks; one may be there twice, as pieces of a broken line.
        ends: (N, 2, 3) end points on the plane z = 1, without lens distortion.
    """

    ids: Ids
    ends: Array

    @staticmethod
    def of(tracks: LineTracks, lines: str = "observed_px") -> View:
        """What the frontend says of a frame whose camera is known.

        A piece of a broken line is that line. What counts is each frame's own measurement, for the adjustment does
        itself what the fused lines, "segments_px", are made for. ValueError without a camera.
        """
        if tracks.camera is None:
            raise ValueError("odometry needs a camera: give the source a calibration")
        ends = tracks.camera.normalize(getattr(tracks, lines))
        known = np.isfinite(ends).all(axis=(1, 2))
        ids = np.where(tracks.fragment_of >= 0, tracks.fragment_of, tracks.ids)
        return View(ids[known], homogeneous(ends[known]))

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class Observations:
    """Lines in several views, ordered by their line.

    Attributes:
        ids: (N,) tracks, ascending; row k is line k.
        line: (M,) row of each observation's line, ascending.
        view: (M,) row of its view.
        ends: (M, 2, 3) its end points on the plane z = 1.
        focal: px, to weigh distances on that plane.
    """

    ids: Ids
    line: NDArray[np.intp]
    view: NDArray[np.intp]
    ends: Array
    focal: float

    @cached_property
    def starts(self) -> NDArray[np.intp]:
        """(N,) first observation of each line."""
        return np.searchsorted(self.line, np.arange(len(self.ids)))

    @cached_property
    def counts(self) -> NDArray[np.intp]:
        """(N,) number of observations of each line."""
        return np.bincount(self.line, minlength=len(self.ids))

    def errors(self, lines: Array, poses: Array) -> Array:
        """(M, 2) distances of the end points to the images of lines (N, 2, 3), px."""
        return self.focal * distances(self.ends, image_lines(lines[self.line], poses[self.view]))

    def sums(self, values: Array) -> Array:
        """(N, ...) sums over each line's observations of values (M, ...)."""
        return np.add.reduceat(values, self.starts) if len(self.ids) else np.zeros((0, *values.shape[1:]))

    def only(self, keep: NDArray[np.bool_]) -> Observations:
        """The observations of the lines (N,) to keep."""
        rows = np.flatnonzero(keep[self.line])
        renumbered = np.cumsum(keep) - 1
        return Observations(self.ids[keep], renumbered[self.line[rows]], self.view[rows], self.ends[rows], self.focal)


def gather(views: Sequence[View], focal: float, least: int, ids: Ids | None = None) -> Observations:
    """The lines that were observed at least so many times, of all tracks or of the given ones."""
    tracks = np.concatenate([view.ids for view in views])
    place = np.repeat(np.arange(len(views)), [len(view) for view in views])
    ends = np.concatenate([view.ends for view in views])
    if ids is not None:
        wanted = np.isin(tracks, ids)
        tracks, place, ends = tracks[wanted], place[wanted], ends[wanted]
    order = np.argsort(tracks, kind="stable")
    found, line, counts = np.unique(tracks[order], return_inverse=True, return_counts=True)
    return Observations(found, line, place[order], ends[order], focal).only(counts >= least)

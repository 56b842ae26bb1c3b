"""What cameras saw of tracked lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from frontend import LineTracks

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
TINY = 1e-12


@dataclass(frozen=True)
class View:
    """The lines of one frame, on the plane z = 1 without the lens.

    Attributes:
        ids: (N,) tracks; one may be there twice, as pieces of a broken line.
        ends: (N, 2, 2) end points as observed.
        lines: (N, 3) a, b, c: a u + b v + c is the distance of (u, v) from the line.
        variances: (N, 2) of the line's offset at its middle, and of its angle, radians.
    """

    ids: Ids
    ends: Array
    lines: Array
    variances: Array

    @staticmethod
    def of(tracks: LineTracks) -> View:
        """What the frontend says of a frame whose camera is known; a piece of a broken line is that line.

        Raises:
            ValueError: no camera.
        """
        if tracks.observed_normalized is None:
            raise ValueError("odometry needs a camera: give the source a calibration")
        covariances = tracks.observed_line_covariances
        known = np.isfinite(tracks.observed_normalized).all(axis=(1, 2)) & np.isfinite(covariances).all(axis=(1, 2))
        ids = np.where(tracks.fragment_of >= 0, tracks.fragment_of, tracks.ids)
        arrays = tracks.observed_normalized, tracks.observed_lines, np.einsum("nii->ni", covariances)
        return View(ids[known], *(np.float64(values[known]) for values in arrays))

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class Observations:
    """Lines in several views, ordered by their line.

    Attributes:
        ids: (N,) tracks, ascending; row k is line k.
        line: (M,) row of each observation's line, ascending.
        view: (M,) row of its view.
        ends, lines, variances: (M, ...) as in `View`.
    """

    ids: Ids
    line: NDArray[np.intp]
    view: NDArray[np.intp]
    ends: Array
    lines: Array
    variances: Array

    @cached_property
    def starts(self) -> NDArray[np.intp]:
        """(N,) first observation of each line."""
        return np.searchsorted(self.line, np.arange(len(self.ids)))

    @cached_property
    def counts(self) -> NDArray[np.intp]:
        """(N,) number of observations of each line."""
        return np.bincount(self.line, minlength=len(self.ids))

    def sums(self, values: Array) -> Array:
        """(N, ...) sums over each line's observations of values (M, ...)."""
        return np.add.reduceat(values, self.starts) if len(self.ids) else np.zeros((0, *values.shape[1:]))

    def only(self, keep: NDArray[np.bool_]) -> Observations:
        """The observations of the lines (N,) to keep."""
        rows = np.flatnonzero(keep[self.line])
        arrays = {name: getattr(self, name)[rows] for name in ("view", "ends", "lines", "variances")}
        return replace(self, ids=self.ids[keep], line=(np.cumsum(keep) - 1)[self.line[rows]], **arrays)


def gather(views: Sequence[View], least: int, ids: Ids | None = None) -> Observations:
    """The lines that were observed at least so many times, of all tracks or of the given ones."""
    tracks = np.concatenate([view.ids for view in views])
    place = np.repeat(np.arange(len(views)), [len(view) for view in views])
    wanted = np.flatnonzero(np.isin(tracks, ids)) if ids is not None else np.arange(len(tracks))
    order = wanted[np.argsort(tracks[wanted], kind="stable")]
    found, line, counts = np.unique(tracks[order], return_inverse=True, return_counts=True)
    arrays = (np.concatenate([getattr(view, name) for view in views])[order] for name in ("ends", "lines", "variances"))
    return Observations(found, line, place[order], *arrays).only(counts >= least)

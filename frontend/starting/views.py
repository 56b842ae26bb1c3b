"""What a camera saw of lines and points, on the plane z = 1, and what three views have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from frontend.tracks import LineTracks

MOST_LINES, MOST_POINTS = 120, 150  # of three views that are looked at
POINT_ERROR, CORNER_ERROR = 0.2, 0.4  # px, standard deviation
MEETING = 6.0  # px from both lines' ends to where they meet, of a corner
LEAST_SINE = 0.35  # between them: the corner of near-parallel lines is anywhere
TINY = 1e-12

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


@dataclass(frozen=True)
class View:
    """Lines and points of one frame, ids ascending. Of a broken line it is the longest piece.

    Attributes:
        ids, confirmed: (N,).
        ends: (2, N, 3) the lines' end points.
        normals: (N, 3) their coefficients.
        errors: (2, N, 3) what two independent errors of one standard deviation change of these,
        across: (2, 2, N) and how far such an error (axis 0) moves an end (axis 1) across the line.
        point_ids, points: (P,), (P, 3).
        focal: px.
    """

    ids: Ids
    confirmed: NDArray[np.bool_]
    ends: Array
    normals: Array
    errors: Array
    across: Array
    point_ids: Ids
    points: Array
    focal: float

    @staticmethod
    def of(tracks: LineTracks) -> View:
        """What a frame measured; ConfigError without a camera."""
        ends, covariances, lines = tracks.observed_normalized, tracks.observed_line_covariances, tracks.observed_lines
        points = tracks.points_normalized
        if tracks.camera is None or ends is None or covariances is None or lines is None or points is None:
            raise ConfigError("a start needs a camera: give the source a calibration")
        whole = np.where(tracks.fragment_of >= 0, tracks.fragment_of, tracks.ids)
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        good = np.flatnonzero(np.isfinite(covariances).all(axis=(1, 2)) & (covariances[:, 0, 0] > 0) & (length > 0))
        order = good[np.lexsort((-length[good], whole[good]))]
        ids, first = np.unique(whole[order], return_index=True)
        rows = order[first]
        n, both = lines[rows].astype(np.float64), np.moveaxis(rays(ends[rows]), 1, 0)
        middle = both.mean(axis=0)
        # an error of the offset moves the coefficient c, one of the angle turns (a, b) about the middle
        slopes = np.stack([(0, 0, -1) + 0 * n, np.cross(middle, n) * (0, 0, 1) + n[:, [1, 0, 2]] * (-1, 1, 0)])
        (xx, xy), (_, yy) = np.moveaxis(covariances[rows].astype(np.float64), 0, 2)
        steep = xy / np.sqrt(xx)  # Cholesky's factor, of offset and angle
        own = np.stack([np.sqrt(xx), 0 * xx, steep, np.sqrt(np.maximum(yy - steep**2, 0) + TINY)], axis=1).reshape(
            -1, 2, 2
        )
        lever = own[:, 1] * length[rows, None] / 2
        known = np.isfinite(points).all(axis=1)
        return View(
            ids=ids,
            confirmed=tracks.confirmed[rows],
            ends=both,
            normals=n,
            errors=np.einsum("nae,anc->enc", own, slopes),
            across=np.moveaxis(np.stack([own[:, 0] - lever, own[:, 0] + lever], axis=2), 0, 2),
            point_ids=tracks.point_ids[known],
            points=rays(points[known]),
            focal=float(tracks.camera.matrix[0, 0]),
        )

    def take(self, ids: Ids, point_ids: Ids) -> View:
        """Only these lines and points, all of which it has."""
        rows, points = np.searchsorted(self.ids, ids), np.searchsorted(self.point_ids, point_ids)
        arrays = {name: getattr(self, name)[rows] for name in ("confirmed", "normals")}
        arrays |= {name: getattr(self, name)[:, rows] for name in ("ends", "errors")}
        return replace(
            self, ids=ids, across=self.across[..., rows], point_ids=point_ids, points=self.points[points], **arrays
        )


def common(views: Sequence[View]) -> list[View]:
    """The views with those lines and points alone that all of them saw."""
    ids, point_ids = views[0].ids, views[0].point_ids
    for view in views[1:]:
        ids = np.intersect1d(ids, view.ids, assume_unique=True)
        point_ids = np.intersect1d(point_ids, view.point_ids, assume_unique=True)
    return [view.take(ids, point_ids) for view in views]


@dataclass(frozen=True)
class Seen:
    """Lines, points and corners that three views saw: the first, one between, and the last.

    Attributes:
        views: the three, each with the same lines and points.
        rays: (3, M, 3) the points, and then the corners.
        sigmas: (M,) their standard deviations, on the plane.
        flow: how many of them are points.
    """

    views: list[View]
    rays: Array
    sigmas: Array
    flow: int

    @staticmethod
    def of(views: Sequence[View]) -> Seen:
        """What three views have in common: lines that are confirmed in the last, not more than it takes."""
        found = common(views)
        ids, points = found[2].ids[found[2].confirmed], found[2].point_ids
        ids, points = ids[:: 1 + len(ids) // MOST_LINES], points[:: 1 + len(points) // MOST_POINTS]
        found = [view.take(ids, points) for view in found]
        meeting = corners(found)
        sigmas = np.repeat([POINT_ERROR, CORNER_ERROR], [len(points), meeting.shape[1]]) / found[0].focal
        return Seen(found, np.concatenate([[view.points for view in found], meeting], axis=1), sigmas, len(points))


def corners(views: Sequence[View]) -> Array:
    """(V, C, 3) where two lines meet with an end of each nearby, in all views: most often, that is a point in space."""
    n, ends = (np.stack([getattr(view, name) for view in views]) for name in ("normals", "ends"))
    i, j = np.triu_indices(n.shape[1], 1)
    meeting = np.cross(n[:, i], n[:, j])
    wide = (np.abs(meeting[..., 2]) > LEAST_SINE).all(axis=0)
    meeting = meeting[:, wide] / meeting[:, wide, 2:]
    gaps = [np.linalg.norm(meeting[:, None] - ends[:, :, rows[wide]], axis=3).min(axis=1) for rows in (i, j)]
    return np.asarray(meeting[:, (np.maximum(*gaps) * views[0].focal < MEETING).all(axis=0)])


def rays(points: NDArray[np.floating]) -> Array:
    """(..., 3) points on the plane with a third coordinate of 1 from (..., 2) ones."""
    return np.concatenate([points.astype(np.float64), np.ones((*points.shape[:-1], 1))], axis=-1)

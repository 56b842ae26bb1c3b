"""Simple ways to compare with: trackers by nearest neighbour and by optical flow, partners in a right image by rows.

Their constants were chosen on rendered sequences that the evaluation does not contain.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.errors import from_extra
from airline.evaluation.metrics import measure_pairs
from airline.image import to_gray, to_uint8
from airline.lines import LineSet
from frontend.evaluation.truth import Tracked
from frontend.frame import Frame

with from_extra("evaluate"):
    from scipy.optimize import linear_sum_assignment

Segments = NDArray[np.float32]
Array = NDArray[np.float64]

MAX_MISSED = 5  # frames in a row without a line before a track ends
MIN_COSINE = float(np.cos(np.deg2rad(12.0)))
MIN_OVERLAP = 0.3
OVERLAP_WORTH = 5.0  # px of distance that full overlap makes up for
SMOOTHING = 0.8  # weight of the newest shift in a velocity
FLOW: dict[str, Any] = {
    "winSize": (31, 31),
    "maxLevel": 3,
    "criteria": (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 0.03),
}
MAX_ROUND_TRIP = 1.0  # px, forward-backward error
RANGE = 0.25  # of the right image's width: the largest disparity
END_ERROR = 0.3  # px, taken for end points
SLACK, MIN_COMMON, MIN_COSINE_ON_ROWS, MAX_LEVELS = 1.0, 0.5, float(np.cos(np.deg2rad(10.0))), 20.0
_PLACES = np.array([-0.5, 0.0, 0.5])  # start, mid-point and end along a line


class NearestTracker:
    """Each track moves on with its own velocity across the line and takes the nearest line, one to one.

    Along the line, where its mid-point jumps whenever an end does, it moves as most tracks do, and so do new tracks.
    """

    def __init__(self) -> None:
        self._tracks = _Tracks(max_distance=7.0)
        self._velocities = np.zeros((0, 2))
        self._common = np.zeros(2)

    def update(self, frame: Frame, lines: LineSet, edges: NDArray[np.float32] | None = None) -> Tracked:
        """Take the lines of the next frame."""
        before, ids = self._tracks.segments, self._tracks.ids
        own = self._velocities - self._common
        across = (before[:, 1] - before[:, 0])[:, ::-1] * (-1, 1)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        motion = self._common + (own * across).sum(axis=1, keepdims=True) * across
        tracked = self._tracks.update((before + motion[:, None]).astype(np.float32), lines.segments)
        _, old, now = np.intersect1d(ids, tracked.ids, assume_unique=True, return_indices=True)
        shift = tracked.segments_px[now].mean(axis=1) - before[old].mean(axis=1)
        self._velocities[old] += SMOOTHING * (shift - self._velocities[old])
        self._common = np.median(shift, axis=0) if len(shift) else np.zeros(2)
        velocities = np.tile(self._common, (len(self._tracks.ids), 1))
        _, old, now = np.intersect1d(ids, self._tracks.ids, assume_unique=True, return_indices=True)
        velocities[now] = self._velocities[old]
        self._velocities = velocities
        return tracked


class FlowTracker:
    """Pyramidal Lucas-Kanade flow (Bouguet 2001) moves ends and mid-point; the nearest line is taken, one to one."""

    def __init__(self) -> None:
        self._tracks = _Tracks(max_distance=2.0)
        self._image: NDArray[np.uint8] | None = None

    def update(self, frame: Frame, lines: LineSet, edges: NDArray[np.float32] | None = None) -> Tracked:
        """Take the lines of the next frame."""
        image = to_uint8(to_gray(frame.image))
        predicted = self._tracks.segments
        if self._image is not None and len(predicted):
            predicted = _follow(self._image, image, predicted)
        self._image = image
        return self._tracks.update(predicted, lines.segments)


class _Tracks:
    """Ids, ascending, and last segments of the living tracks, seen or predicted."""

    def __init__(self, max_distance: float) -> None:
        self.ids = np.zeros(0, np.int64)
        self.segments: Segments = np.zeros((0, 2, 2), np.float32)
        self._max_distance = max_distance
        self._missed = np.zeros(0, np.int64)
        self._next_id = 0

    def update(self, predicted: Segments, lines: Segments) -> Tracked:
        """Give lines (M, 2, 2), px, to the tracks, which should be at `predicted` (N, 2, 2); end old, begin new ones.

        The pairs are those of `nearest_pairs`.
        """
        rows, columns = nearest_pairs(predicted, lines, self._max_distance)
        matched = lines[columns]
        turned = ((matched[:, 1] - matched[:, 0]) * (predicted[rows, 1] - predicted[rows, 0])).sum(axis=1) < 0
        matched[turned] = matched[turned, ::-1]
        segments, missed, line_of = predicted.copy(), self._missed + 1, np.full(len(self.ids), -1, np.int32)
        segments[rows], missed[rows], line_of[rows] = matched, 0, columns
        new = np.setdiff1d(np.arange(len(lines), dtype=np.int32), columns)
        alive = missed <= MAX_MISSED
        self.ids = np.concatenate([self.ids[alive], np.arange(self._next_id, self._next_id + len(new))])
        self.segments = np.concatenate([segments[alive], lines[new]])
        self._missed = np.concatenate([missed[alive], np.zeros(len(new), np.int64)])
        self._next_id += len(new)
        line_of = np.concatenate([line_of[alive], new])
        seen = line_of >= 0
        return Tracked(self.ids[seen], line_of[seen], self.segments[seen], np.full(int(seen.sum()), -1, np.int64))


def nearest_pairs(
    predicted: Segments, lines: Segments, max_distance: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of one-to-one pairs, as many as the gates allow, at the least total cost."""
    distance, overlap, cosine = measure_pairs(predicted, lines)
    allowed = (distance <= max_distance) & (overlap >= MIN_OVERLAP) & (cosine >= MIN_COSINE)
    costs = np.where(allowed, distance + OVERLAP_WORTH * (1 - overlap), 1e3 * (max_distance + OVERLAP_WORTH))
    rows, columns = linear_sum_assignment(costs)
    kept = allowed[rows, columns]
    return rows[kept], columns[kept]


def _follow(before: NDArray[np.uint8], after: NDArray[np.uint8], segments: Segments) -> Segments:
    """Segments moved by the flow of those of their points that pass the forward-backward check.

    Three points or two give shift and turn, one gives the shift, and without any the line takes the median flow.
    """
    points = np.ascontiguousarray(np.stack([segments[:, 0], segments.mean(axis=1), segments[:, 1]], axis=1))
    start = points.reshape(-1, 1, 2)
    moved, there, _ = cv2.calcOpticalFlowPyrLK(before, after, start, None, **FLOW)
    returned, back, _ = cv2.calcOpticalFlowPyrLK(after, before, moved, None, **FLOW)
    trusted = (there[:, 0] > 0) & (back[:, 0] > 0) & (np.hypot(*(returned - start)[:, 0].T) < MAX_ROUND_TRIP)
    flow, weight = (moved - start).reshape(points.shape), trusted.reshape(points.shape[:2]).astype(np.float64)
    count = weight.sum(axis=1)[:, None]
    common = np.median(flow.reshape(-1, 2)[trusted], axis=0) if trusted.any() else np.zeros(2)
    mean = np.where(count > 0, np.einsum("np,npc->nc", weight, flow) / np.maximum(count, 1), common)
    centre = (weight * _PLACES).sum(axis=1)[:, None] / np.maximum(count, 1)
    arm = weight * (_PLACES - centre)
    spread = (arm * _PLACES).sum(axis=1)[:, None]
    slope = np.einsum("np,npc->nc", arm, flow) / np.where(spread > 0, spread, 1)
    ends = np.stack([mean + (-0.5 - centre) * slope, mean + (0.5 - centre) * slope], axis=1)
    return np.asarray(segments + ends, np.float32)


def nearest_on_rows(
    left: Segments, right: Segments, left_gray: NDArray[np.uint8], right_gray: NDArray[np.uint8]
) -> NDArray[np.intp]:
    """The partner of each left line (N, 2, 2) among right lines (M, 2, 2), px: row, -1 for none.

    Of the lines with half of the shorter one's rows in common, at most 10 degrees between them, and grey levels on
    both sides that differ by at most 20, the one with the least disparity from 0 to a quarter of the image's width;
    one to one, least disparities first.
    """
    ours, theirs = (np.where(a[:, :1, 1:] > a[:, 1:, 1:], a[:, ::-1], a).astype(np.float64) for a in (left, right))
    levels = _levels(ours, left_gray)[:, None], _levels(theirs, right_gray)
    ours = ours[:, None]
    (ux, uy), (vx, vy) = ((a[..., 1, :] - a[..., 0, :]).transpose(2, 0, 1) for a in (ours, theirs[None]))
    top, bottom = np.maximum(ours[..., 0, 1], theirs[:, 0, 1]), np.minimum(ours[..., 1, 1], theirs[:, 1, 1])
    shifts = _in_rows(ours, (top + bottom) / 2) - _in_rows(theirs, (top + bottom) / 2)
    alike = bottom - top + 2 * SLACK >= MIN_COMMON * (np.minimum(uy, vy) + 2 * SLACK)
    alike &= np.abs(ux * vx + uy * vy) >= MIN_COSINE_ON_ROWS * np.hypot(ux, uy) * np.hypot(vx, vy)
    alike &= np.abs(levels[0] - levels[1]).max(axis=2) <= MAX_LEVELS
    alike &= (shifts >= 0) & (shifts <= RANGE * left_gray.shape[1])
    partner, free = np.full(len(left), -1), np.ones(len(right), np.bool_)
    rows, columns = np.nonzero(alike)
    for k in np.argsort(shifts[alike]):
        if partner[rows[k]] < 0 and free[columns[k]]:
            partner[rows[k]], free[columns[k]] = columns[k], False
    return partner


def _in_rows(lines: Array, y: Array) -> Array:
    """X of lines in rows, or of their nearer ends."""
    along = (y - lines[..., 0, 1]) / np.maximum(lines[..., 1, 1] - lines[..., 0, 1], 1e-9)
    return np.asarray(lines[..., 0, 0] + np.clip(along, 0, 1) * (lines[..., 1, 0] - lines[..., 0, 0]))


def _levels(lines: Array, gray: NDArray[np.uint8]) -> Array:
    """(N, 2) mean grey levels 3 px aside of lines."""
    delta = lines[:, 1] - lines[:, 0]
    across = delta[:, ::-1] * (-1, 1) / np.maximum(np.hypot(*delta.T), 1e-9)[:, None]
    steps = lines.mean(axis=1) + np.linspace(-0.4, 0.4, 9)[:, None, None] * delta
    points = steps + 3.0 * np.array([-1, 1])[:, None, None, None] * across
    x, y = np.clip(np.rint(points), 0, np.array(gray.shape)[::-1] - 1).astype(np.intp).transpose(3, 0, 1, 2)
    return np.asarray(gray[y, x].mean(axis=1).T)


def end_errors(lines: Segments) -> Segments:
    """(N, 2, 2) covariances of offset and angle of lines with independent errors of their ends."""
    covariances = np.zeros((len(lines), 2, 2), np.float32)
    covariances[:, 0, 0] = END_ERROR**2 / 2
    covariances[:, 1, 1] = 2 * END_ERROR**2 / np.maximum(((lines[:, 1] - lines[:, 0]) ** 2).sum(axis=1), 1)
    return covariances

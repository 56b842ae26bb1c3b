"""The window of keyframes and what they see as a factor graph: GTSAM's fixed-lag smoother.

A keyframe that is older than the lag is marginalised, together with the points that it was the first to see. So what is
left of them ties poses to poses, and the graph stays sparse. A track that goes on begins anew from what the window saw.
"""

from __future__ import annotations

from collections.abc import Iterable

import gtsam
import numpy as np
from gtsam.symbol_shorthand import P, X

from line_odometry.residual import Marks, factor
from line_odometry.views import Array, Ids

LAG = 12  # keyframes
LEAST_VIEWS = 3, 2  # of a mark, for one camera and for a pair
ITERATIONS, GAIN = 4, 1e-2  # for each keyframe: most of them, and the relative gain at which they end
FIXED = 1e-3  # standard deviation of what holds the world: the first pose, and the first distance
VAGUE = 1.0  # of a point where it was first found, in distances from the camera


class Smoother:
    """Poses of the newest keyframes, and the points that they see."""

    def __init__(self, poses: Array, number: int, baseline_m: float = 0.0) -> None:
        """Hold the first of poses (K, 3, 4), keyframe `number`; and how far the last one is from it, but for a pair."""
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(ITERATIONS)
        parameters.setRelativeErrorTol(GAIN)
        self._smoother = gtsam.BatchFixedLagSmoother(LAG - 0.5, parameters)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._points: dict[int, tuple[int, int]] = {}  # of a mark: number of its point, and of its first keyframe
        self._count, self._newest, self._estimate = 0, number - 1, gtsam.Values()
        distance = float(np.linalg.norm(poses[-1][:3, 3] - poses[0][:3, 3]))
        ends, sigma = (X(number), X(number + len(poses) - 1)), gtsam.noiseModel.Isotropic.Sigma
        self._graph.add(gtsam.PriorFactorPose3(ends[0], _pose(poses[0]), sigma(6, FIXED)))
        self._cameras = [gtsam.Pose3()]  # of a keyframe's views, in its axes
        if baseline_m:
            self._cameras.append(gtsam.Pose3(gtsam.Rot3(), np.array([baseline_m, 0, 0])))
        else:
            self._graph.add(gtsam.RangeFactorPose3(*ends, distance, sigma(1, FIXED)))

    def places(self, ids: Ids, places: Array, first: int) -> Array:
        """(..., 3) where marks (...) are: those in the window from keyframe `first`; the others as given."""
        places = places.copy()
        for at, mark in np.ndenumerate(ids):
            number, born = self._points.get(mark, (0, -1))
            if born >= first:
                places[at] = self._estimate.atPoint3(P(number))
        return places

    def update(self, first: int, poses: Array, seen: Iterable[Marks]) -> Array:
        """Add what is new of the keyframes in the window and of what they see; the poses afterwards.

        Args:
            first: number of the first keyframe.
            poses: (K, 3, 4) of all.
            seen: what they saw; of a pair the views 2 k and 2 k + 1 are the left and right one of keyframe k.
        """
        stamps, sides = {}, len(self._cameras)
        for number, pose in enumerate(poses, first):
            if number > self._newest:
                self._values.insert(X(number), _pose(pose))
                stamps[X(number)] = float(number)
        for marks in seen:
            far = np.linalg.norm(marks.places - poses[-1][:, 3], axis=1)
            bounds = np.searchsorted(marks.row, np.arange(len(marks.ids) + 1))
            for row, mark in enumerate(marks.ids.tolist()):
                rows = range(bounds[row], bounds[row + 1])
                new = self._points.get(mark, (0, -1))[1] < first
                if new:
                    if mark in self._points:  # again: what it said of the older half has stayed in the graph
                        rows = [k for k in rows if marks.view[k] >= sides * (LAG // 2)]
                    if len(rows) < LEAST_VIEWS[sides - 1]:
                        continue
                    self._points[mark] = self._count, first + int(marks.view[rows[0]]) // sides
                    self._count += 1
                number, born = self._points[mark]
                if new:
                    self._values.insert(P(number), marks.places[row])
                    stamps[P(number)] = float(born)
                    vague = gtsam.noiseModel.Isotropic.Sigma(3, VAGUE * far[row])
                    self._graph.add(gtsam.PriorFactorPoint3(P(number), marks.places[row], vague))
                for k in rows:
                    at, side = divmod(int(marks.view[k]), sides)
                    if new or first + at > self._newest:
                        information = marks.held[k] if new and k == rows[-1] else marks.information[k]
                        camera = self._cameras[side]
                        self._graph.add(factor(marks.measured[k], information, X(first + at), P(number), camera))
        self._newest = first + len(poses) - 1
        self._smoother.update(self._graph, self._values, stamps)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._estimate = self._smoother.calculateEstimate()
        return np.array([self._estimate.atPose3(X(number)).matrix()[:3] for number in range(first, self._newest + 1)])


def _pose(pose: Array) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(pose[:3, :3]), pose[:3, 3])

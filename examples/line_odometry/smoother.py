"""Keyframes and the map as a factor graph, smoothed by GTSAM's iSAM2 (Kaess et al. 2012)."""

from __future__ import annotations
import os
from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from line_odometry.residual import Chart, line_factor
from line_odometry.views import Array, Observations

LAG = 16
FIXED = 1e-3  # standard deviation of what holds the world: the first pose, and the first distance
VAGUE = 1.0  # of a line where it was first found, in distances from the camera
REPEATED = int(os.environ.get("REP","2"))  # updates for each keyframe, until what the first one moves has settled
MOVED = {"x": (6, 1e-3), "l": (4, float(os.environ.get("PMOVED","0.03")))}  # variables, their size, and the change from which on they are linearised anew


class Smoother:
    """Poses of the keyframes, and the lines that they see."""

    def __init__(self, first: Array, last: Array, number: int) -> None:
        """Begin with the pose (3, 4) of keyframe 0, and with its distance from that of another one."""
        parameters, thresholds = gtsam.ISAM2Params(), gtsam.ISAM2ThresholdMap()
        for symbol, (size, change) in MOVED.items():
            thresholds.insert((symbol, np.full(size, change)))
        parameters.setRelinearizeThreshold(thresholds)
        parameters.relinearizeSkip = 1
        if os.environ.get("QR"): parameters.setFactorization("QR")
        self._smoother = gtsam.ISAM2(parameters)
        self._charts: dict[int, Chart] = {}
        distance = float(np.linalg.norm(last[:, 3] - first[:, 3]))
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._graph.add(gtsam.PriorFactorPose3(X(0), _pose(first), gtsam.noiseModel.Isotropic.Sigma(6, FIXED)))
        self._graph.add(gtsam.RangeFactorPose3(X(0), X(number), distance, gtsam.noiseModel.Isotropic.Sigma(1, FIXED)))

    def update(self, numbers: Sequence[int], poses: Array, seen: Observations, ends: Array) -> tuple[Array, Array]:
        """Add what is new of keyframes and of the lines in them.

        Args:
            numbers: of keyframes, ascending, counted from 0 without a gap.
            poses: (K, 3, 4) of these.
            seen: what they saw; the lines that are good enough.
            ends: (N, 2, 3) points of these.

        Returns:
            The poses and points afterwards.
        """
        there, groups = self._smoother.getLinearizationPoint(), gtsam.KeyGroupMap()
        new = [not there.exists(X(number)) for number in numbers]
        for number, pose, is_new in zip(numbers, poses, new, strict=True):
            if is_new:
                self._values.insert(X(number), _pose(pose))
            groups.insert2(X(number), 1)
        far = np.linalg.norm(ends.mean(axis=1) - poses[-1][:, 3], axis=1)
        for row, track in enumerate(seen.ids.tolist()):
            known = track in self._charts
            if not known:
                self._charts[track] = Chart.at(ends[row], far[row])
                self._values.insert(L(track), np.zeros(4))
                self._graph.add(gtsam.PriorFactorVector(L(track), np.zeros(4), gtsam.noiseModel.Isotropic.Sigma(4, VAGUE * far[row])))
            groups.insert2(L(track), 0)
            for k in range(seen.starts[row], seen.starts[row] + seen.counts[row]):
                if new[seen.view[k]] or not known:
                    self._graph.add(line_factor(X(numbers[seen.view[k]]), L(track), self._charts[track], seen.ends[k], seen.variances[k]))
        self._smoother.update(self._graph, self._values, constrainedKeys=groups)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for _ in range(REPEATED - 1):
            self._smoother.update()
        found = self._smoother.calculateEstimate()
        points = np.array([self._charts[track].line(found.atVector(L(track))) for track in seen.ids.tolist()])
        return np.array([found.atPose3(X(number)).matrix()[:3] for number in numbers]), points.reshape(-1, 2, 3)


def _pose(pose: Array) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(pose[:, :3]), pose[:, 3])

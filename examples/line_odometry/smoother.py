"""The window of keyframes and their lines as a factor graph: GTSAM's fixed-lag smoother.

A keyframe that is older than the lag is marginalised, together with the lines that it was the first to see. So what is
left of them ties poses to poses, and the graph stays sparse. A line that goes on begins anew from what the window saw.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, X

from line_odometry.residual import FREE, HELD, line_factor
from line_odometry.triangulation import across
from line_odometry.views import Array, Observations

LAG = int(os.environ.get("LAG","16"))  # keyframes
ITERATIONS = int(os.environ.get("ITER","5"))
FIXED = 1e-3  # standard deviation of what holds the world: the first pose, and the first distance
VAGUE = float(os.environ.get("VAGUE","1"))  # of a point where it was first found, in distances from the camera
NEAR = 0.1  # depth of a point that counts, in distances from the camera


class Smoother:
    """Poses of the newest keyframes, and the lines that they see."""

    def __init__(self, first: Array, last: Array, number: int) -> None:
        """Begin with the pose (3, 4) of keyframe 0, and with its distance from that of another one."""
        if os.environ.get("INC"):
            p=gtsam.ISAM2Params(); p.relinearizeSkip=1
            th=gtsam.ISAM2ThresholdMap()
            for c,n,v in (("x",6,1e-3),("a",3,.03),("b",3,.03)): th.insert((c,np.full(n,v)))
            p.setRelinearizeThreshold(th); p.setFactorization("QR")
            self._smoother = gtsam.IncrementalFixedLagSmoother(LAG-.5, p)
        else:
            parameters = gtsam.LevenbergMarquardtParams()
            parameters.setMaxIterations(ITERATIONS)
            if os.environ.get("QR"): parameters.setLinearSolverType("MULTIFRONTAL_QR")
            parameters.setRelativeErrorTol(1e-3)
            self._smoother = gtsam.BatchFixedLagSmoother(LAG-.5, parameters)
        self._lines: dict[int, tuple[int, int, Array]] = {}  # of a track: number of its line, of its first keyframe, points
        self._count = 0
        distance = float(np.linalg.norm(last[:, 3] - first[:, 3]))
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._graph.add(gtsam.PriorFactorPose3(X(0), _pose(first), gtsam.noiseModel.Isotropic.Sigma(6, FIXED)))
        self._graph.add(gtsam.RangeFactorPose3(X(0), X(number), distance, gtsam.noiseModel.Isotropic.Sigma(1, FIXED)))
        self._newest = -1

    def update(self, numbers: Sequence[int], poses: Array, seen: Observations, ends: Array) -> tuple[Array, Array]:
        """Add what is new of keyframes and of the lines in them.

        Args:
            numbers: of the keyframes in the window, ascending, counted from 0 without a gap.
            poses: (K, 3, 4) of these.
            seen: what they saw; the lines that are good enough.
            ends: (N, 2, 3) points of these.

        Returns:
            The poses and points afterwards.
        """
        stamps = {}
        for number, pose in zip(numbers, poses, strict=True):
            if number > self._newest:
                self._values.insert(X(number), _pose(pose))
                stamps[X(number)] = float(number)
        tracks, firsts = seen.ids.tolist(), [numbers[k] for k in seen.view[seen.starts].tolist()]
        known = [track in self._lines and self._lines[track][1] >= numbers[0] for track in tracks]
        points = np.array([self._lines[track][2] if old else pair for track, old, pair in zip(tracks, known, ends, strict=True)]).reshape(-1, 2, 3)
        own = poses[seen.view]
        off, variances, depth, image = across(points[seen.line], seen, own)
        far = np.linalg.norm(points - poses[-1][:, 3], axis=2)
        for row, track in enumerate(tracks):
            if not known[row]:
                self._lines[track] = self._count, firsts[row], points[row]
                self._count += 1
            serial, born, _ = self._lines[track]
            rows = range(seen.starts[row], seen.starts[row] + seen.counts[row])
            for end, symbol in enumerate((A, B)):
                key = symbol(serial)
                good = [k for k in rows if depth[k, end] > NEAR * far[row, end] and (not known[row] or numbers[seen.view[k]] > self._newest)]
                if not known[row]:
                    self._values.insert(key, points[row, end])
                    stamps[key] = float(born)
                    vague = gtsam.noiseModel.Isotropic.Sigma(3, VAGUE * far[row, end])
                    self._graph.add(gtsam.PriorFactorPoint3(key, points[row, end], vague))
                for k in good:
                    along = HELD if not known[row] and k == good[-1] else FREE
                    self._graph.add(line_factor(X(numbers[seen.view[k]]), key, image[k, end], off[k, end], variances[k, end] ** 0.5, seen.lines[k], along))
        self._newest = numbers[-1]
        self._smoother.update(self._graph, self._values, stamps)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if os.environ.get("INC"): self._smoother.update()
        found = self._smoother.calculateEstimate()
        for track in tracks:
            serial, born, _ = self._lines[track]
            if found.exists(A(serial)): self._lines[track] = serial, born, np.stack([found.atPoint3(A(serial)), found.atPoint3(B(serial))])
        return np.array([found.atPose3(X(number)).matrix()[:3] for number in numbers]), None


def _pose(pose: Array) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(pose[:, :3]), pose[:, 3])

"""The lines that one frame has: those detected, and those found where a track was predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airline.lines import LineSet
from frontend.tracking.appearance import side_profiles
from frontend.tracking.measurement import line_covariances
from frontend.tracking.overlap import LineFeatures


@dataclass(frozen=True)
class Seen:
    """Lines of one frame: first those detected, then those measured for tracks that no detected line takes.

    Attributes:
        features: of all N lines.
        errors: (N, 2, 2) float32 covariances of offset and angle.
        scores: (N,) float32.
        detected: how many of them are.
    """

    features: LineFeatures
    errors: NDArray[np.float32]
    scores: NDArray[np.float32]
    detected: int

    def along(self, rows: NDArray[np.int32], segments: NDArray[np.float32]) -> LineFeatures:
        """Some of the lines, turned so that each has the direction of its row of (K, 2, 2) segments."""
        lines = self.features.take(rows)
        back = runs_backwards(segments, lines.segments)
        lines.segments[back], lines.profiles[back] = lines.segments[back, ::-1], lines.profiles[back, ::-1]
        return lines


def detected(lines: LineSet, gray: NDArray[np.uint8]) -> Seen:
    """The detector's lines of a (H, W) image."""
    features = LineFeatures(lines.segments, lines.descriptors, side_profiles(gray, lines.segments))
    return Seen(features, line_covariances(lines.segments, lines.residuals), lines.scores, len(lines))


def runs_backwards(reference: NDArray[np.float32], segments: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(N,) mask of the segments that point against their (N, 2, 2) reference."""
    a, b = reference[:, 1] - reference[:, 0], segments[:, 1] - segments[:, 0]
    backwards: NDArray[np.bool_] = (a * b).sum(axis=1) < 0
    return backwards

"""Are tracks lines in space? What a backend makes of them with the true poses of the camera."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frontend.evaluation.metrics import figure, ratio, rms
from frontend.evaluation.observations import Observations
from frontend.evaluation.posed import Posed
from frontend.evaluation.space import distances, image_lines, triangulate

MIN_FRAMES = 5
MAX_ERROR = 2.0  # px
LENGTHS = {"<20": 0, "20-40": 20, "40-80": 40, ">80": 80}  # groups and where they begin, px
FRAMES = {"5-8": 5, "9-16": 9, "17-32": 17, ">32": 33}

Array = NDArray[np.float64]


def image_fits(observations: Observations, segments: Array, clip: Posed) -> Array:
    """(R, 3) images of the line in space that fits the segments (R, 2, 2) of each track, see `image_lines`."""
    lines = np.zeros((len(observations), 3))
    for low, high in pairwise(observations.starts):
        poses = clip.poses[observations.frames[low:high]]
        lines[low:high] = image_lines(poses, triangulate(poses, segments[low:high], clip.K), clip.K)
    return lines


def consistency(observations: Observations, segments: Array, clip: Posed, frames: int) -> dict[str, Any]:
    """How many of the tracks seen in 5 frames and more are one line in space.

    A triangulated track is consistent if the end points of all its observations are within 2 px of the reprojected
    infinite line. Lines that move by themselves never are, lines that point where the camera goes always.

    Args:
        observations: the run.
        segments: (R, 2, 2) those of its lines that are triangulated, px.
        clip: its camera.
        frames: how many there were, from the clip's first one on.

    Returns:
        tracks, consistent, share: tracks, those of them that are consistent, and their share, None without any.
        observations_per_frame: of consistent tracks; rms_across_px: of their end points from the reprojected line;
        length_mean: frames of a consistent track. by_length, by_frames: the first three by the mean length of a track's
        observations, px, and by the number of frames in which it was seen.
    """
    long = observations.seen_in(MIN_FRAMES)
    observations, segments = observations.take(long), segments[long]
    counts = np.diff(observations.starts)
    errors = distances(segments, image_fits(observations, segments, clip))
    first = observations.starts[:-1]
    good = np.maximum.reduceat(errors.max(axis=1), first) <= MAX_ERROR if len(first) else np.zeros(0, np.bool_)
    within = np.repeat(good, counts)
    delta = observations.observed_px[:, 1] - observations.observed_px[:, 0]
    lengths = np.add.reduceat(np.hypot(*delta.T), first) / counts if len(first) else np.zeros(0)
    return {
        **_share(good),
        "observations_per_frame": ratio(within.sum(), frames) or 0.0,
        "rms_across_px": figure(rms, errors[within].ravel()),
        "length_mean": figure(np.mean, counts[good]),
        "by_length": _groups(good, lengths, LENGTHS),
        "by_frames": _groups(good, counts, FRAMES),
    }


def _share(good: NDArray[np.bool_]) -> dict[str, Any]:
    return {"tracks": len(good), "consistent": int(good.sum()), "share": figure(np.mean, good)}


def _groups(good: NDArray[np.bool_], values: Array | NDArray[np.intp], begins: Mapping[str, int]) -> dict[str, Any]:
    group = np.digitize(values, list(begins.values())) - 1
    return {name: _share(good[group == k]) for k, name in enumerate(begins)}

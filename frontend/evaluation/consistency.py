"""Are tracks lines in space? What a backend makes of them with the true poses of the camera."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from frontend.evaluation.observations import Observations
from frontend.evaluation.posed import Posed
from frontend.evaluation.space import distances, image_lines, parallax, triangulate

MIN_FRAMES = 5
MAX_ERROR = 2.0  # px
LENGTHS = {"<20": 0, "20-40": 20, "40-80": 40, ">80": 80}  # groups and where they begin, px
FRAMES = {"5-8": 5, "9-16": 9, "17-32": 17, ">32": 33}

Array = NDArray[np.float64]


class Share(TypedDict):
    """Tracks, those of them that are consistent, and their share, None without any."""

    tracks: int
    consistent: int
    share: float | None


class Consistency(Share):
    """How many of the tracks seen in 5 frames and more are one line in space.

    A triangulated track is consistent if the end points of all its observations are within 2 px of the reprojected
    infinite line. Lines that move by themselves never are, lines that point where the camera goes always.

    Attributes:
        observations_per_frame: of consistent tracks, over all frames of the clip.
        rms_across_px: of their end points from the reprojected line.
        length_mean: frames of a consistent track.
        parallax_deg: median angle between the farthest two planes of a track.
        by_length: groups by the mean length of a track's observations, px.
        by_frames: groups by the number of frames in which it was seen.
    """

    observations_per_frame: float
    rms_across_px: float | None
    length_mean: float | None
    parallax_deg: float | None
    by_length: dict[str, Share]
    by_frames: dict[str, Share]


def image_fits(observations: Observations, segments: Array, clip: Posed) -> Array:
    """(R, 3) images of the line in space that fits the segments (R, 2, 2) of each track, see `image_lines`."""
    lines = np.zeros((len(observations), 3))
    for low, high in pairwise(observations.starts):
        poses = clip.poses[observations.frames[low:high]]
        lines[low:high] = image_lines(poses, triangulate(poses, segments[low:high], clip.K), clip.K)
    return lines


def consistency(observations: Observations, segments: Array, clip: Posed, frames: int) -> Consistency:
    """Figures of a tracker's run over the first `frames` frames of a clip.

    Args:
        observations: the run.
        segments: (R, 2, 2) those of its lines that are triangulated, px.
        clip: its camera.
        frames: how many there were.
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
    poses = clip.poses[observations.frames]
    angles = [parallax(poses[low:high], segments[low:high], clip.K) for low, high in pairwise(observations.starts)]
    return {
        **_share(good),
        "observations_per_frame": round(within.sum() / frames, 4) if frames else 0.0,
        "rms_across_px": round(float(np.sqrt(np.mean(errors[within] ** 2))), 4) if within.any() else None,
        "length_mean": round(float(counts[good].mean()), 4) if good.any() else None,
        "parallax_deg": round(float(np.median(angles)), 4) if angles else None,
        "by_length": _groups(good, lengths, LENGTHS),
        "by_frames": _groups(good, counts, FRAMES),
    }


def _share(good: NDArray[np.bool_]) -> Share:
    share = round(float(good.mean()), 4) if len(good) else None
    return {"tracks": len(good), "consistent": int(good.sum()), "share": share}


def _groups(good: NDArray[np.bool_], values: Array | NDArray[np.intp], begins: Mapping[str, int]) -> dict[str, Share]:
    group = np.digitize(values, list(begins.values())) - 1
    return {name: _share(good[group == k]) for k, name in enumerate(begins)}

"""The stages of the detector in a recording: edges, orientations, regions, segments and descriptors."""

from __future__ import annotations

import numpy as np
import rerun as rr

from airline.trace import Trace
from frontend.colours import CYCLE, track_colours
from frontend.protocols import FrameResult
from viz.lines import TENTATIVE_RADIUS, log_lines
from viz.pictures import (
    ANGLES,
    QUIET,
    STRENGTHS,
    coarse_descriptors,
    edge_image,
    orientation_classes,
    orientation_palette,
    region_image,
)
from viz.rerun_private import class_names, jpeg, segmentation

# In a corner of every picture of regions: the viewer maps 16-bit classes to colours by the largest of the first one.
LARGEST = CYCLE + 1
STEP = 2  # stages are logged at half the resolution: their views are small, and their pictures most of a recording


def log_colours(stream: rr.RecordingStream) -> None:
    """Log, once, what the numbers in `/camera/orientation` and `/camera/regions` stand for.

    Orientations say angle and edge probability when the mouse is over them; regions have the colours of the tracks that
    the lines belong to.
    """
    angle, strength = np.divmod(np.arange(ANGLES * STRENGTHS), STRENGTHS)
    names = [f"{180 * a // ANGLES}°, {100 * s // STRENGTHS} % and more" for a, s in zip(angle, strength, strict=True)]
    stream.log("/camera/orientation", class_names(orientation_palette()[1:], names), static=True)
    regions = np.concatenate([track_colours(np.arange(CYCLE)), np.zeros((1, 3), np.uint8)])
    stream.log("/camera/regions", class_names(regions, [None] * len(regions)), static=True)


def log_stages(stream: rr.RecordingStream, result: FrameResult, quality: int) -> None:
    """Log edges, orientations and regions, at half the resolution, and the segments.

    The class of a region is 1 + the id of its line's track modulo `CYCLE`, 0 for a line without a track.
    """
    trace, tracks = result.trace, result.tracks
    stream.log("/camera/edges", jpeg(edge_image(trace, STEP), quality))
    stream.log("/camera/orientation", segmentation(orientation_classes(trace, STEP)))
    classes = np.zeros(len(trace.lines), np.uint16)
    classes[tracks.line_indices] = 1 + tracks.ids % CYCLE
    regions = region_image(trace, classes, STEP)
    regions[0, 0] = LARGEST
    stream.log("/camera/regions", segmentation(regions))
    log_lines(stream, "/camera/segments", trace.lines.segments, np.array([QUIET], np.uint8), TENTATIVE_RADIUS)


def log_descriptors(stream: rr.RecordingStream, trace: Trace) -> None:
    """Log the orientation descriptors as numbers, at a quarter of the resolution."""
    stream.log("/camera/descriptor", rr.Tensor(coarse_descriptors(trace), dim_names=("y", "x", "channel")))

"""The stages of the detector: as small pictures, and what of them goes into a recording."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from airline.trace import Trace
from frontend.colours import CYCLE, hsv_to_rgb, track_colours
from frontend.protocols import FrameResult
from viz.lines import THIN_RADIUS, log_lines, picture_scale
from viz.rerun_private import class_names, jpeg, segmentation

ANGLES, STRENGTHS = 60, 4  # that colours tell apart: 3 degrees, and quarters of the edge probability
MIN_STRENGTH = 0.35
# In a corner of every picture of regions: the viewer maps 16-bit classes to colours by the largest of the first one.
LARGEST = CYCLE + 1
STEP = 2  # stages are logged at half the resolution: their views are small, and their pictures most of a recording


@cache
def orientation_palette() -> NDArray[np.uint8]:
    """(1 + ANGLES * STRENGTHS, 3) uint8 RGB: black, then each angle in all strengths.

    A half turn is once around the hue circle, from red at 0. Probable edges are brighter, none below `MIN_STRENGTH`.
    """
    angle, strength = np.divmod(np.arange(ANGLES * STRENGTHS), STRENGTHS)
    value = MIN_STRENGTH + (1 - MIN_STRENGTH) * strength / (STRENGTHS - 1)
    colours = hsv_to_rgb(angle / ANGLES, np.full(len(angle), 0.75), value)
    return np.concatenate([np.zeros((1, 3), np.uint8), colours])


def edge_image(trace: Trace, step: int = 1) -> NDArray[np.uint8]:
    """(H / step, W / step) uint8, rounded up: edge probability, 255 is certain; means over cells of step x step px."""
    edges = trace.edges
    if step > 1:
        height, width = _cells(trace, step)
        edges = np.asarray(cv2.resize(edges, (width, height), interpolation=cv2.INTER_AREA), np.float32)
    return np.asarray(cv2.convertScaleAbs(edges, alpha=255), np.uint8)


def line_angles(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(M,) float32 angles in [0, pi) of (M, C) orientation descriptors, whose channel n answers to the angle n pi / C.

    Undirected angles average on the doubled angle (Mardia and Jupp, Directional Statistics, 1.5).
    """
    doubled = np.arange(descriptors.shape[1]) * (2 * np.pi / descriptors.shape[1])
    basis = np.stack([np.cos(doubled), np.sin(doubled)], axis=1).astype(np.float32)
    c, s = np.ascontiguousarray((descriptors @ basis).T)  # contiguous: numpy's SIMD code wants that
    angles: NDArray[np.float32] = np.arctan2(s, c) / 2
    return np.asarray(angles + np.float32(np.pi) * (angles < 0), np.float32)


def coarse_descriptors(trace: Trace) -> NDArray[np.float32]:
    """(H / 4, W / 4, C) float32, rounded up: a descriptor out of each cell, zero in cells without edge pixels."""
    coarse = np.zeros((*_cells(trace, 4), trace.descriptors.shape[1]), np.float32)
    x, y = trace.pixels.T // 4
    coarse[y, x] = trace.descriptors
    return coarse


def orientation_classes(trace: Trace, step: int = 1) -> NDArray[np.uint8]:
    """(H / step, W / step) uint8, rounded up: angle and probability of an edge pixel out of each cell, 0 without any.

    They are rows of `orientation_palette`.
    """
    height, width = _cells(trace, step)
    angle = np.rint(line_angles(trace.descriptors) * np.float32(ANGLES / np.pi)).astype(np.uint8) % ANGLES
    strength = np.minimum(trace.edges.take(_cell_of_each(trace, 1)) * np.float32(STRENGTHS), STRENGTHS - 1)
    picture = np.zeros(height * width, np.uint8)
    picture[_cell_of_each(trace, step)] = 1 + angle * STRENGTHS + strength.astype(np.uint8)
    return picture.reshape(height, width)


def segment_colours(segments: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(N, 3) uint8 RGB of (N, 2, 2) segments: hue is the angle, as in `orientation_palette`."""
    dx, dy = (segments[:, 1] - segments[:, 0]).T
    angle = np.rint(np.arctan2(dy, dx) * (ANGLES / np.pi)).astype(int) % ANGLES
    colours: NDArray[np.uint8] = orientation_palette()[STRENGTHS * (1 + angle)]
    return colours


def orientation_image(trace: Trace) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB: hue is an edge pixel's angle, brightness its edge probability; the rest is black."""
    return orientation_palette()[orientation_classes(trace)]


def region_image(trace: Trace, classes: NDArray[np.uint16], step: int = 1) -> NDArray[np.uint16]:
    """(H / step, W / step) uint16, rounded up: the class (N,) of the line that a pixel of each cell supports, or 0."""
    height, width = _cells(trace, step)
    picture = np.zeros(height * width, np.uint16)
    supporting = np.flatnonzero(trace.labels >= 0)
    picture[_cell_of_each(trace, step)[supporting]] = classes[trace.labels[supporting]]
    return picture.reshape(height, width)


def _cell_of_each(trace: Trace, step: int) -> NDArray[np.intp]:
    """(M,) the cell that each pixel lies in, counted row by row; of the kind that arrays are indexed with."""
    x, y = np.ascontiguousarray(trace.pixels.T) // step
    return np.asarray(y * np.int32(_cells(trace, step)[1]) + x, np.intp)


def _cells(trace: Trace, step: int) -> tuple[int, int]:
    height, width = trace.edges.shape
    return -(-height // step), -(-width // step)


def log_colours(stream: rr.RecordingStream) -> None:
    """Log, once, what the numbers in `/camera/orientation` and `/camera/regions` stand for.

    Orientations say angle and probability under the mouse; regions have the colours of their lines' tracks.
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
    detected = ~tracks.measured
    classes[tracks.line_indices[detected]] = 1 + tracks.ids[detected] % CYCLE
    regions = region_image(trace, classes, STEP)
    regions[0, 0] = LARGEST
    stream.log("/camera/regions", segmentation(regions))
    radius = THIN_RADIUS * picture_scale(trace.edges.shape)
    log_lines(stream, "/camera/segments", trace.lines.segments, segment_colours(trace.lines.segments), radius)


def log_descriptors(stream: rr.RecordingStream, trace: Trace) -> None:
    """Log the orientation descriptors as numbers, at a quarter of the resolution."""
    stream.log("/camera/descriptor", rr.Tensor(coarse_descriptors(trace), dim_names=("y", "x", "channel")))

"""What the detector computed, as small pictures."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.trace import Trace
from viz.colours import angle_colours

MIN_STRENGTH = 0.35  # an edge pixel that the detector kept is never drawn darker than this


def edge_image(trace: Trace, step: int = 1) -> NDArray[np.uint8]:
    """(H / step, W / step) uint8, rounded up: edge probability, 255 is certain; means over cells of step x step px."""
    edges = trace.edges
    if step > 1:
        height, width = _cells(trace, step)
        edges = np.asarray(cv2.resize(edges, (width, height), interpolation=cv2.INTER_AREA), np.float32)
    return np.asarray(cv2.convertScaleAbs(edges, alpha=255), np.uint8)


def line_angles(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(M,) float32 angles in [0, pi) of (M, C) orientation descriptors, whose channel n answers to the angle n pi / C.

    Angles of undirected lines average on the doubled angle, where 0 and pi meet (Mardia and Jupp, Directional
    Statistics, 1.5).
    """
    doubled = np.arange(descriptors.shape[1]) * (2 * np.pi / descriptors.shape[1])
    basis = np.stack([np.cos(doubled), np.sin(doubled)], axis=1).astype(np.float32)
    c, s = (descriptors @ basis).T
    angles: NDArray[np.float32] = np.mod(np.arctan2(s, c) / 2, np.float32(np.pi))
    return angles


def coarse_descriptors(trace: Trace, step: int = 4) -> NDArray[np.float32]:
    """(H / step, W / step, C) float32, rounded up: a descriptor out of each cell, zero in cells without edge pixels."""
    coarse = np.zeros((*_cells(trace, step), trace.descriptors.shape[1]), np.float32)
    x, y = trace.pixels.T // step
    coarse[y, x] = trace.descriptors
    return coarse


def orientation_image(trace: Trace, step: int = 1) -> NDArray[np.uint8]:
    """(H / step, W / step, 3) uint8 RGB, rounded up: one edge pixel out of each cell; black where there is none.

    Hue is the pixel's angle, brightness its edge probability.
    """
    height, width = _cells(trace, step)
    x, y = trace.pixels.T
    chosen = np.full(height * width, -1, np.int32)
    chosen[(y // step) * width + x // step] = np.arange(len(x), dtype=np.int32)
    cells = np.flatnonzero(chosen >= 0)
    pixels = chosen[cells]
    strength = np.clip(trace.edges[y[pixels], x[pixels]], MIN_STRENGTH, 1)
    picture = np.zeros((height * width, 3), np.uint8)
    picture[cells] = angle_colours(line_angles(trace.descriptors[pixels]), strength)
    return picture.reshape(height, width, 3)


def region_image(trace: Trace, classes: NDArray[np.uint16], step: int = 1) -> NDArray[np.uint16]:
    """Which pixels support which line.

    Args:
        trace: the detector's results.
        classes: (N,) uint16 number to draw the region of each line with.
        step: cells of step x step px show one of their pixels.

    Returns:
        (H / step, W / step) uint16, rounded up; 0 where no pixel supports a line.
    """
    picture = np.zeros(_cells(trace, step), np.uint16)
    supporting = trace.labels >= 0
    x, y = trace.pixels[supporting].T // step
    picture[y, x] = classes[trace.labels[supporting]]
    return picture


def _cells(trace: Trace, step: int) -> tuple[int, int]:
    height, width = trace.edges.shape
    return -(-height // step), -(-width // step)

"""What the detector computed, as 8-bit pictures."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.trace import Trace
from viz.colours import angle_colours

MIN_STRENGTH = 0.35  # an edge pixel that the detector kept is never drawn darker than this


def edge_image(trace: Trace) -> NDArray[np.uint8]:
    """(H, W) uint8: edge probability, 255 is certain."""
    return np.asarray(cv2.convertScaleAbs(trace.edges, alpha=255), np.uint8)


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
    height, width = (-(-size // step) for size in trace.edges.shape)
    coarse = np.zeros((height, width, trace.descriptors.shape[1]), np.float32)
    x, y = trace.pixels.T // step
    coarse[y, x] = trace.descriptors
    return coarse


def orientation_image(trace: Trace) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB: hue is the angle at each edge pixel, brightness its edge probability, black elsewhere."""
    picture = np.zeros((*trace.edges.shape, 3), np.uint8)
    x, y = trace.pixels.T
    strength = np.clip(trace.edges[y, x], MIN_STRENGTH, 1)
    picture[y, x] = angle_colours(line_angles(trace.descriptors), strength)
    return picture

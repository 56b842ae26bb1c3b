"""What the detector computed, as small pictures, and their colours."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.trace import Trace
from frontend.colours import hsv_to_rgb

ANGLES, STRENGTHS = 60, 4  # that colours tell apart: 3 degrees, and quarters of the edge probability
MIN_STRENGTH = 0.35
QUIET = (255, 196, 64)  # segments, which are not yet part of any track, RGB


@cache
def orientation_palette() -> NDArray[np.uint8]:
    """(1 + ANGLES * STRENGTHS, 3) uint8 RGB: black, then each angle in all strengths.

    A half turn of an undirected line is once around the hue circle, from red at 0. An edge is brighter the more
    probable it is, but never darker than `MIN_STRENGTH`.
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

    Angles of undirected lines average on the doubled angle, where 0 and pi meet (Mardia and Jupp, Directional
    Statistics, 1.5).
    """
    doubled = np.arange(descriptors.shape[1]) * (2 * np.pi / descriptors.shape[1])
    basis = np.stack([np.cos(doubled), np.sin(doubled)], axis=1).astype(np.float32)
    c, s = np.ascontiguousarray((descriptors @ basis).T)  # contiguous: numpy's vector instructions want that
    angles: NDArray[np.float32] = np.arctan2(s, c) / 2
    return np.asarray(angles + np.float32(np.pi) * (angles < 0), np.float32)


def coarse_descriptors(trace: Trace, step: int = 4) -> NDArray[np.float32]:
    """(H / step, W / step, C) float32, rounded up: a descriptor out of each cell, zero in cells without edge pixels."""
    coarse = np.zeros((*_cells(trace, step), trace.descriptors.shape[1]), np.float32)
    x, y = trace.pixels.T // step
    coarse[y, x] = trace.descriptors
    return coarse


def orientation_classes(trace: Trace, step: int = 1) -> NDArray[np.uint8]:
    """(H / step, W / step) uint8, rounded up: angle and edge probability of one edge pixel out of each cell.

    Row of `orientation_palette`, which says what each stands for; 0 where there is no edge pixel.
    """
    height, width = _cells(trace, step)
    angle = np.rint(line_angles(trace.descriptors) * np.float32(ANGLES / np.pi)).astype(np.uint8) % ANGLES
    strength = np.minimum(trace.edges.take(_cell_of_each(trace, 1)) * np.float32(STRENGTHS), STRENGTHS - 1)
    picture = np.zeros(height * width, np.uint8)
    picture[_cell_of_each(trace, step)] = 1 + angle * STRENGTHS + strength.astype(np.uint8)
    return picture.reshape(height, width)


def orientation_image(trace: Trace, step: int = 1) -> NDArray[np.uint8]:
    """(H / step, W / step, 3) uint8 RGB, rounded up: one edge pixel out of each cell; black where there is none.

    Hue is the pixel's angle, brightness its edge probability.
    """
    return orientation_palette()[orientation_classes(trace, step)]


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
    cells: NDArray[np.intp] = (y * np.int32(_cells(trace, step)[1]) + x).astype(np.intp)
    return cells


def _cells(trace: Trace, step: int) -> tuple[int, int]:
    height, width = trace.edges.shape
    return -(-height // step), -(-width // step)

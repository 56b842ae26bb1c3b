"""Edge maps of ideal lines with known parameters, and the error of a detection against them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline import AirLine, CannyEdges

SIZE = 160
HALF_LENGTH = 50.0
ANGLES = np.arange(36) * 5.0


def ideal_line(degrees: float, shift: tuple[float, float]) -> NDArray[np.float64]:
    """(2, 2) end points of a 100 px line through the map's centre plus `shift`."""
    centre = (SIZE - 1) / 2 + np.array(shift)
    direction = np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])
    return np.stack([centre - HALF_LENGTH * direction, centre + HALF_LENGTH * direction])


def soft_map(line: NDArray[np.float64], sigma: float = 0.8) -> NDArray[np.float32]:
    """A Gaussian ridge on the line, as the network is trained to answer."""
    y, x = np.mgrid[:SIZE, :SIZE]
    delta = line[1] - line[0]
    share = np.clip(((x - line[0, 0]) * delta[0] + (y - line[0, 1]) * delta[1]) / (delta @ delta), 0, 1)
    squared = (x - line[0, 0] - share * delta[0]) ** 2 + (y - line[0, 1] - share * delta[1]) ** 2
    return np.exp(-squared / (2 * sigma**2)).astype(np.float32)


def binary_map(line: NDArray[np.float64]) -> NDArray[np.float32]:
    """A one-pixel-wide staircase: per column (or row) the pixel nearest to the line."""
    edges = np.zeros((SIZE, SIZE), np.float32)
    delta = line[1] - line[0]
    major = int(abs(delta[1]) > abs(delta[0]))
    low, high = sorted(line[:, major])
    steps = np.arange(np.ceil(low), np.floor(high) + 1)
    other = line[0, 1 - major] + (steps - line[0, major]) * delta[1 - major] / delta[major]
    index = (np.rint(other).astype(int), steps.astype(int))
    edges[index if major == 0 else index[::-1]] = 1
    return edges


def measure(preset: str, edges: NDArray[np.float32], truth: NDArray[np.float64]) -> tuple[int, float, float, float]:
    """How many lines the stages after edge detection find, and of the longest one against the truth: the angle,
    degrees, the offset across the line and the worse end point, px.
    """
    lines = AirLine(preset, edges=CannyEdges()).trace_edges(edges).lines
    if not len(lines):
        return 0, np.inf, np.inf, np.inf
    segment = lines.segments[np.argmax(lines.lengths)].astype(np.float64)
    delta = truth[1] - truth[0]
    unit, found = delta / np.linalg.norm(delta), segment[1] - segment[0]
    angle = np.degrees(np.arcsin(min(1.0, abs(unit[0] * found[1] - unit[1] * found[0]) / np.linalg.norm(found))))
    gap = segment.mean(axis=0) - truth.mean(axis=0)
    ends = min(np.linalg.norm(pair - truth, axis=1).max() for pair in (segment, segment[::-1]))
    return len(lines), float(angle), float(abs(gap[0] * unit[1] - gap[1] * unit[0])), float(ends)

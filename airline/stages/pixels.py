"""Which pixels of an edge map lines are made of: the thin ridge of a soft map, or every pixel above a threshold."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.config import EdgeConfig
from airline.kernels.compiled import njit
from airline.kernels.threads import ALONE, ThreadTeam


@dataclass(frozen=True)
class EdgePixels:
    """Edge pixels in raster order; row k of every array speaks of the same pixel.

    Attributes:
        support: (H, W) float32 the map the pixels were taken from, for the descriptors.
        pixels: (M, 2) int32 (x, y).
        positions: (M, 2) float32 sub-pixel positions of the edge (x, y), px.
        weights: (M,) float32 edge strength in [0, 1].
    """

    support: NDArray[np.float32]
    pixels: NDArray[np.int32]
    positions: NDArray[np.float32]
    weights: NDArray[np.float32]


class PixelSelector(Protocol):
    """Picks the edge pixels of an edge map."""

    def select(self, edges: NDArray[np.float32]) -> EdgePixels:
        """Edge pixels of an (H, W) float32 edge probability map."""
        ...


@dataclass(frozen=True)
class ThresholdPixels:
    """Every pixel at or above the threshold, at its integer position, described by the binary map, as in the paper."""

    config: EdgeConfig = field(default_factory=EdgeConfig)

    def select(self, edges: NDArray[np.float32]) -> EdgePixels:
        """See `PixelSelector.select`."""
        support = (edges >= self.config.threshold).astype(np.float32)
        y, x = np.nonzero(support)
        pixels = np.stack([x, y], axis=1).astype(np.int32)
        return EdgePixels(support, pixels, pixels.astype(np.float32), edges[y, x])


@dataclass(frozen=True)
class RidgePixels:
    """The ridge line of a soft edge map with sub-pixel positions (Steger 1998).

    A pixel is kept where the quadratic approximation of the smoothed map has its maximum across the ridge within
    the pixel. Smoothing makes one ridge of binary and of several-pixel-wide edges too.
    """

    config: EdgeConfig = field(default_factory=EdgeConfig)
    team: ThreadTeam = field(default=ALONE, repr=False, compare=False)

    def select(self, edges: NDArray[np.float32]) -> EdgePixels:
        """See `PixelSelector.select`."""
        side = 3 if self.config.smoothing == "auto" else self.config.smoothing
        smooth = edges
        if side > 1:
            smooth = cv2.GaussianBlur(edges, (side, side), 0, borderType=cv2.BORDER_REPLICATE)
        threshold = np.float32(self.config.threshold)
        parts = self.team.map_range(len(edges), 64, lambda start, end: _ridge(smooth, edges, threshold, start, end))
        pixels, positions, weights = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        return EdgePixels(smooth, pixels, positions, weights)


ZERO, QUARTER, HALF, ONE, TWO = (np.float32(value) for value in (0, 0.25, 0.5, 1, 2))
FLAT = np.float32(-1e-6)  # curvature that is none
TINY = np.float32(1e-24)
REACH = np.float32(0.6)  # px: half a pixel, and some more, so that diagonal ridges stay 8-connected


@njit()
def _ridge(smooth, edges, threshold, start, end):  # type: ignore[no-untyped-def]
    """(M, 2) int32 ridge pixels of rows `start` to `end` of (H, W) float32 maps; float32 positions and weights."""
    height, width = edges.shape
    capacity = 0
    for y in range(start, end):
        line = edges[y]
        for x in range(width):
            capacity += line[x] >= threshold
    pixels = np.empty((capacity, 2), np.int32)
    positions = np.empty((capacity, 2), np.float32)
    weights = np.empty(capacity, np.float32)
    count = 0
    rows = np.empty((3, width + 2), np.float32)
    steps = np.empty((3, width), np.float32)
    kept = np.empty(width + 1, np.int32)
    for y in range(start, end):
        for k in range(3):
            source, row = smooth[min(max(y + k - 1, 0), height - 1)], rows[k]
            for x in range(width):
                row[x + 1] = source[x]
            row[0], row[width + 1] = source[0], source[width - 1]
        line = edges[y]
        _ridge_steps(rows, line, threshold, steps)
        dx, dy, far = steps[0], steps[1], steps[2]
        here = 0
        for x in range(width):  # without branches, which would be guessed wrong
            kept[here] = x
            here += far[x] <= REACH
        for k in range(here):
            x = kept[k]
            pixels[count, 0], pixels[count, 1] = x, y
            positions[count, 0], positions[count, 1] = x + dx[x], y + dy[x]
            weights[count] = min(ONE, line[x])
            count += 1
    return pixels[:count], positions[:count], weights[:count]


@njit(fastmath={"nsz", "arcp", "contract"})
def _ridge_steps(rows, edges, threshold, steps):  # type: ignore[no-untyped-def]
    """Set `steps`, (3, W) float32: from each pixel to the ridge in x and y and the greater of both, px; 2 for none.

    `rows` (3, W + 2) float32 are the row and its neighbours with a margin, `edges` (W,) the row before smoothing.
    Without branches, so that it compiles to SIMD instructions.
    """
    above, here, below = rows[0], rows[1], rows[2]
    a0, a1, a2 = above[:-2], above[1:-1], above[2:]
    b0, b1, b2 = here[:-2], here[1:-1], here[2:]
    c0, c1, c2 = below[:-2], below[1:-1], below[2:]
    dx, dy, far = steps[0], steps[1], steps[2]
    for x in range(len(dx)):
        gx, gy = HALF * (b2[x] - b0[x]), HALF * (c1[x] - a1[x])
        xx, yy = b2[x] - TWO * b1[x] + b0[x], c1[x] - TWO * b1[x] + a1[x]
        xy = QUARTER * (c2[x] - a2[x] - c0[x] + a0[x])
        half = HALF * (xx - yy)
        root = np.sqrt(half * half + xy * xy)
        curvature = HALF * (xx + yy) - root  # most negative second derivative: across the ridge
        # eigenvector of that curvature, from the better conditioned row of H - curvature I
        large = -(abs(half) + root)
        nx, ny = (xy, large) if half > ZERO else (large, xy)
        along = (gx * nx + gy * ny) / (curvature * (nx * nx + ny * ny) - TINY)
        dx[x], dy[x] = -along * nx, -along * ny
        greater = max(abs(dx[x]), abs(dy[x]))
        far[x] = greater if (curvature < FLAT) & (edges[x] >= threshold) else TWO

"""Which pixels of an edge map lines are made of: the thin ridge of a soft map, or every pixel above a threshold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from airline.errors import ConfigError


@dataclass(frozen=True)
class EdgePixels:
    """Edge pixels in raster order; row k of every array speaks of the same pixel.

    Attributes:
        support: (H, W) float32 the map the pixels were taken from, for the descriptors.
        index: (H, W) int32 row of each pixel, -1 away from edges.
        pixels: (M, 2) int32 (x, y).
        positions: (M, 2) float32 sub-pixel positions of the edge (x, y), px.
        weights: (M,) float32 edge strength in [0, 1].
    """

    support: NDArray[np.float32]
    index: NDArray[np.int32]
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
    """Every pixel at or above a threshold, at its integer position, described by the binary map, as in the paper."""

    threshold: float

    def select(self, edges: NDArray[np.float32]) -> EdgePixels:
        """Edge pixels of an (H, W) float32 edge probability map."""
        support = (edges >= self.threshold).astype(np.float32)
        y, x = np.nonzero(support)
        index = np.full(edges.shape, -1, np.int32)
        index[y, x] = np.arange(len(x), dtype=np.int32)
        pixels = np.stack([x, y], axis=1).astype(np.int32)
        return EdgePixels(support, index, pixels, pixels.astype(np.float32), edges[y, x])


@dataclass(frozen=True)
class RidgePixels:
    """The ridge line of a soft edge map with sub-pixel positions (Steger 1998, "An unbiased detector of curvilinear
    structures").

    A pixel is kept where the quadratic approximation of the smoothed map has its maximum across the ridge within
    the pixel. Smoothing makes one ridge of binary and of several-pixel-wide edges too.

    Attributes:
        threshold: edge pixels have at least this probability.
        smoothing: side of the Gaussian window, odd, px; 1 smooths nothing.
    """

    threshold: float
    smoothing: int = 3

    def __post_init__(self) -> None:
        if self.smoothing < 1 or self.smoothing % 2 == 0:
            raise ConfigError("edge smoothing must be an odd number of pixels")

    def select(self, edges: NDArray[np.float32]) -> EdgePixels:
        """Edge pixels of an (H, W) float32 edge probability map."""
        window = (self.smoothing, self.smoothing)
        smooth = cv2.GaussianBlur(edges, window, 0, borderType=cv2.BORDER_REPLICATE)
        padded = cv2.copyMakeBorder(smooth, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        return EdgePixels(smooth, *_ridge(padded, edges, np.float32(self.threshold)))


SLACK = 0.1  # px a ridge may lie beyond the pixel's side, so that diagonal ridges stay 8-connected


@njit(cache=True, nogil=True)
def _ridge(smooth, edges, threshold):  # type: ignore[no-untyped-def]
    height, width = edges.shape
    index = np.full((height, width), -1, np.int32)
    capacity = 0
    for y in range(height):
        for x in range(width):
            if edges[y, x] >= threshold:
                capacity += 1
    pixels = np.empty((capacity, 2), np.int32)
    positions = np.empty((capacity, 2), np.float32)
    weights = np.empty(capacity, np.float32)
    count = 0
    for y in range(height):
        for x in range(width):
            if edges[y, x] < threshold:
                continue
            c = smooth[y + 1, x + 1]
            left, right, above, below = smooth[y + 1, x], smooth[y + 1, x + 2], smooth[y, x + 1], smooth[y + 2, x + 1]
            gx, gy = 0.5 * (right - left), 0.5 * (below - above)
            xx, yy = right - 2 * c + left, below - 2 * c + above
            xy = 0.25 * (smooth[y + 2, x + 2] - smooth[y, x + 2] - smooth[y + 2, x] + smooth[y, x])
            mean, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
            root = np.sqrt(half * half + xy * xy)
            curvature = mean - root  # most negative second derivative: across the ridge
            if curvature >= -1e-6:
                continue
            # eigenvector of that curvature, from the better conditioned row of H - curvature I
            nx, ny = (xy, curvature - xx) if half > 0 else (curvature - yy, xy)
            norm = np.hypot(nx, ny)
            if norm < 1e-12:
                nx, ny, norm = 1.0, 0.0, 1.0
            nx, ny = nx / norm, ny / norm
            step = -(gx * nx + gy * ny) / curvature
            dx, dy = step * nx, step * ny
            if abs(dx) <= 0.5 + SLACK and abs(dy) <= 0.5 + SLACK:
                index[y, x] = count
                pixels[count, 0], pixels[count, 1] = x, y
                positions[count, 0], positions[count, 1] = x + dx, y + dy
                weights[count] = min(1.0, edges[y, x])
                count += 1
    return index, pixels[:count].copy(), positions[:count].copy(), weights[:count].copy()

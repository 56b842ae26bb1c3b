"""Stage 3: conditional region grow (algorithm 1 of the AirLine paper)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.pixels import EdgePixels


@dataclass(frozen=True)
class RegionGrower:
    """Groups 8-connected edge pixels of similar orientation.

    A region starts at an unused seed. An unused neighbour p joins while `D_p . mean(D_R) / |mean(D_R)| >= T`; it is
    then used, and the mean follows. Every pixel belongs to at most one region, and the result depends on nothing but
    the arguments.

    Attributes:
        similarity: T in [0, 1].
        min_pixels: m; regions with fewer pixels are dropped (their pixels stay used).
        seed_threshold: only pixels of at least this weight start a region.
    """

    similarity: float
    min_pixels: int
    seed_threshold: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.similarity <= 1 or self.min_pixels < 1:
            raise ConfigError("region grow needs a similarity in [0, 1] and at least 1 pixel per region")

    def grow(self, edge: EdgePixels, descriptors: NDArray[np.float32]) -> NDArray[np.int32]:
        """Region of each edge pixel.

        Args:
            edge: M edge pixels.
            descriptors: (M, C) float32 unit rows.

        Returns:
            (M,) int32 region numbers from 0 in raster order of their seeds, -1 for pixels in no region.
        """
        labels: NDArray[np.int32] = _grow(
            edge.index,
            edge.pixels,
            edge.weights,
            descriptors,
            np.float32(self.seed_threshold),
            self.similarity,
            self.min_pixels,
        )
        return labels


@njit(cache=True, nogil=True)
def _grow(index, pixels, weights, descriptors, seed_threshold, similarity, min_pixels):  # type: ignore[no-untyped-def]
    height, width = index.shape
    count, channels = descriptors.shape
    labels = np.full(count, -1, np.int32)
    used = np.zeros(count, np.bool_)
    queue = np.empty(count, np.int32)
    total = np.zeros(channels)
    region = 0
    for seed in range(count):
        if used[seed] or weights[seed] < seed_threshold:
            continue
        used[seed] = True
        queue[0] = seed
        head, tail = 0, 1
        for c in range(channels):
            total[c] = descriptors[seed, c]
        while head < tail:
            x, y = pixels[queue[head], 0], pixels[queue[head], 1]
            head += 1
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    if not (0 <= y + dy < height and 0 <= x + dx < width):
                        continue
                    p = index[y + dy, x + dx]
                    if p < 0 or used[p]:
                        continue
                    dot, squared = 0.0, 0.0
                    for c in range(channels):
                        dot += descriptors[p, c] * total[c]
                        squared += total[c] * total[c]
                    if dot >= similarity * np.sqrt(squared):
                        used[p] = True
                        queue[tail] = p
                        tail += 1
                        for c in range(channels):
                            total[c] += descriptors[p, c]
        if tail >= min_pixels:
            for k in range(tail):
                labels[queue[k]] = region
            region += 1
    return labels

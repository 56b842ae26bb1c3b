"""Stage 3: conditional region grow (algorithm 1 of the AirLine paper)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airline.compiled import njit
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
            edge.support.shape,
            edge.pixels,
            edge.weights,
            descriptors,
            np.float32(self.seed_threshold),
            self.similarity,
            self.min_pixels,
            tuple(range(descriptors.shape[1])),
        )
        return labels


ONE, TWO = np.uint64(1), np.uint64(2)


@njit(cache=True, nogil=True, error_model="numpy")
def _grow(shape, pixels, weights, descriptors, seed_threshold, similarity, min_pixels, channels):  # type: ignore[no-untyped-def]
    """`channels` is (0, 1, ...), a tuple since loops over tuples unroll."""
    height, width = shape
    count = len(pixels)
    labels = np.full(count, -1, np.int32)
    # with a margin, so that every pixel has eight neighbours
    stride = width + 2
    free = np.zeros((height + 2) * stride, np.uint8)
    index = np.empty((height + 2) * stride, np.int32)  # set where `free` was once
    places = np.empty(count, np.int64)
    for k in range(count):
        place = np.uint64((pixels[k, 1] + 1) * stride + pixels[k, 0] + 1)
        free[place] = 1
        index[place] = k
        places[k] = place
    queue = np.empty(count, np.int32)
    total = np.zeros(len(channels))
    region = 0
    for seed in range(count):
        if not free[places[seed]] or weights[seed] < seed_threshold:
            continue
        free[places[seed]] = 0
        queue[0] = seed
        head, tail = 0, 1
        squared = 0.0
        for c in range(len(channels)):
            total[c] = descriptors[seed, c]
            squared += total[c] * total[c]
        least = similarity * np.sqrt(squared)
        while head < tail:
            here = places[queue[head]]
            head += 1
            for row in (here - stride, here, here + stride):
                place = np.uint64(row - 1)
                if not free[place] | free[place + ONE] | free[place + TWO]:
                    continue
                for column in range(3):
                    place = np.uint64(row - 1 + column)
                    if not free[place]:
                        continue
                    p = index[place]
                    dot = 0.0
                    for c in range(len(channels)):
                        dot += descriptors[p, c] * total[c]
                    if dot >= least:
                        free[place] = 0
                        queue[tail] = p
                        tail += 1
                        squared = 0.0
                        for c in range(len(channels)):
                            total[c] += descriptors[p, c]
                            squared += total[c] * total[c]
                        least = similarity * np.sqrt(squared)
        if tail >= min_pixels:
            for k in range(tail):
                labels[queue[k]] = region
            region += 1
    return labels

"""Stage 3: conditional region grow (algorithm 1 of the AirLine paper)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airline.config import GrowConfig
from airline.kernels.compiled import njit
from airline.stages.pixels import EdgePixels


class Grower(Protocol):
    """Groups edge pixels into regions, of which each is to become a line."""

    def grow(self, edge: EdgePixels, descriptors: NDArray[np.float32]) -> NDArray[np.int32]:
        """(M,) int32 region of each of M edge pixels with (M, C) float32 descriptors, from 0; -1 for none."""
        ...


@dataclass(frozen=True)
class RegionGrower:
    """Groups 8-connected edge pixels of similar orientation.

    A region starts at an unused seed. An unused neighbour p joins while `D_p . mean(D_R) / |mean(D_R)| >= T`; it is
    then used, and the mean follows. Every pixel belongs to at most one region.

    Attributes:
        config: T and m; pixels of regions that are dropped stay used.
        seed_threshold: only pixels of at least this weight start a region.
    """

    config: GrowConfig = field(default_factory=GrowConfig)
    seed_threshold: float = 0.0

    def grow(self, edge: EdgePixels, descriptors: NDArray[np.float32]) -> NDArray[np.int32]:
        """(M,) int32 region of each of M edge pixels, from 0 in raster order of their seeds; -1 for none.

        `descriptors` are (M, C) float32 unit rows; raises ValueError where the pixels are not in raster order.
        """
        shape, least = edge.support.shape, np.float32(self.seed_threshold)
        kind = np.dtype(np.uint16 if shape[1] < 1 << 16 else np.uint32)
        options = self.config.similarity, self.config.min_pixels, tuple(range(descriptors.shape[1]))
        labels: NDArray[np.int32] = _grow(shape, kind, edge.pixels, edge.weights, descriptors, least, *options)
        return labels


ONE, TWO = np.uint64(1), np.uint64(2)


@njit()
def _grow(shape, kind, pixels, weights, descriptors, seed_threshold, similarity, min_pixels, channels):  # type: ignore[no-untyped-def]
    """(M,) int32 labels; `kind` is a dtype that holds the number of a row's pixels, loops over `channels` unroll."""
    height, width = shape
    count = len(pixels)
    labels = np.full(count, -1, np.int32)
    # With a margin, so that every pixel has eight neighbours. The less memory is looked at, the better: a free pixel is
    # known by its number in its row, from 1 on, and a row by where its pixels begin.
    stride = width + 2
    free = np.zeros((height + 2) * stride, kind)
    before = np.zeros(height + 2, np.int32)
    places = np.empty(count, np.uint32)
    last = -1
    for k in range(count):
        row = pixels[k, 1] + 1
        if row < last:
            raise ValueError("edge pixels must be in raster order")
        if row > last:
            before[row], last = k - 1, row
        places[k] = row * stride + pixels[k, 0] + 1
        free[places[k]] = k - before[row]
    queue, rows = np.empty(count, np.int32), np.empty(count, np.int32)
    total = np.zeros(len(channels), np.float64)
    region = 0
    for seed in range(count):
        if weights[seed] < seed_threshold or not free[places[seed]]:
            continue
        free[places[seed]] = 0
        queue[0], rows[0] = seed, pixels[seed, 1] + 1
        head, tail = 0, 1
        squared = 0.0
        for c in range(len(channels)):
            total[c] = descriptors[seed, c]
            squared += total[c] * total[c]
        least = similarity * np.sqrt(squared)
        while head < tail:
            here, row = np.int64(places[np.uint64(queue[head])]), rows[head]
            head += 1
            for down in range(-1, 2):
                left = np.uint64(here + down * stride - 1)
                if not free[left] | free[left + ONE] | free[left + TWO]:
                    continue
                first = before[np.uint64(row + down)]
                for column in range(3):
                    place = left + np.uint64(column)
                    number = free[place]
                    if not number:
                        continue
                    p = np.uint64(first + number)
                    dot = 0.0
                    for c in range(len(channels)):
                        dot += descriptors[p, c] * total[c]
                    if dot >= least:
                        free[place] = 0
                        queue[tail], rows[tail] = p, row + down
                        tail += 1
                        squared = 0.0
                        for c in range(len(channels)):
                            total[c] += descriptors[p, c]
                            squared += total[c] * total[c]
                        least = similarity * np.sqrt(squared)
        if tail >= min_pixels:
            for k in range(tail):
                labels[np.uint64(queue[k])] = region
            region += 1
    return labels

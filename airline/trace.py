"""Everything the detector computed on the way from an image to its lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airline.lines import LineSet


@dataclass(frozen=True)
class Trace:
    """Intermediate results of one image, for viewers and for debugging.

    Edge pixels are sparse: row k of `pixels`, `descriptors` and `labels` speaks of the same pixel.

    Attributes:
        edges: (H, W) float32 edge probability in [0, 1].
        pixels: (M, 2) int32 edge pixels as (x, y), in raster order.
        positions: (M, 2) float32 sub-pixel ridge positions (x, y) of these pixels, px.
        descriptors: (M, C) float32 orientation descriptors, unit rows.
        labels: (M,) int32 index of the line in `lines` that the pixel belongs to, or -1.
        lines: the detected segments.
        stage_ms: milliseconds spent per stage: edges, pixels, orientation, grow, fit, refine.
    """

    edges: NDArray[np.float32]
    pixels: NDArray[np.int32]
    positions: NDArray[np.float32]
    descriptors: NDArray[np.float32]
    labels: NDArray[np.int32]
    lines: LineSet
    stage_ms: Mapping[str, float]

    @cached_property
    def label_map(self) -> NDArray[np.int32]:
        """(H, W) int32 line index at each pixel, -1 where there is none."""
        labels = np.full(self.edges.shape, -1, np.int32)
        labels[self.pixels[:, 1], self.pixels[:, 0]] = self.labels
        return labels

    @cached_property
    def descriptor_map(self) -> NDArray[np.float32]:
        """(H, W, C) float32 orientation descriptors, zero away from edge pixels."""
        dense = np.zeros((*self.edges.shape, self.descriptors.shape[1]), np.float32)
        dense[self.pixels[:, 1], self.pixels[:, 0]] = self.descriptors
        return dense

    def region_pixels(self, line: int) -> NDArray[np.int32]:
        """(K, 2) int32 pixels (x, y) of the region behind line `line`."""
        pixels: NDArray[np.int32] = self.pixels[self.labels == line]
        return pixels

"""The detector's result: a set of line segments, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T", float, NDArray[Any])


@dataclass(frozen=True)
class LineSet:
    """Line segments of one image.

    Pixel coordinates have x to the right, y down, and (0, 0) at the centre of the top-left pixel.

    Attributes:
        segments: (N, 2, 2) float32, px; each row is [[x0, y0], [x1, y1]].
        scores: (N,) float32 in [0, 1]; higher is more reliable.
        descriptors: (N, C) float32 orientation descriptors, rows of unit length.
        residuals: (N,) float32 rms distance of each line's edge pixels from it, px; None from fitters that know none.
    """

    segments: NDArray[np.float32]
    scores: NDArray[np.float32]
    descriptors: NDArray[np.float32]
    residuals: NDArray[np.float32] | None = None

    def __len__(self) -> int:
        return len(self.segments)

    @property
    def lengths(self) -> NDArray[np.float32]:
        """(N,) float32 lengths in px."""
        delta = self.segments[:, 1] - self.segments[:, 0]
        lengths: NDArray[np.float32] = np.hypot(delta[:, 0], delta[:, 1])
        return lengths

    @property
    def angles(self) -> NDArray[np.float32]:
        """(N,) float32 angles of the undirected lines in [0, pi), radians, from x towards y."""
        delta = self.segments[:, 1] - self.segments[:, 0]
        angles: NDArray[np.float32] = np.mod(np.arctan2(delta[:, 1], delta[:, 0]), np.float32(np.pi))
        return angles


def scale_points(points: T, factor: T | float) -> T:
    """Positions in an image, px, where they lie in that image resized by `factor`; centres of pixels are whole."""
    return (points + 0.5) * factor - 0.5

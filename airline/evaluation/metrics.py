"""Pixel-level scores of line detections against annotated lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

RADII = (0, 1, 2, 3, 5, 10)


@dataclass(frozen=True)
class PixelScores:
    """Scores of one image, or the mean over many, in percent.

    Attributes:
        lp: Line Precision per radius of `RADII` (equation 7 of the AirLine paper): the share of the sparsely
            annotated pixels within r px of a detected one. It is a recall, so read it beside a precision.
        p1: share of the detected pixels within 1 px of a densely annotated one.
        r1: share of the densely annotated pixels within 1 px of a detected one.
        p2: `p1` at 2 px.
        r2: `r1` at 2 px.
    """

    lp: tuple[float, ...]
    p1: float
    r1: float
    p2: float
    r2: float

    @property
    def f1(self) -> float:
        """F-score at 1 px: the harmonic mean of `p1` and `r1`."""
        return 2 * self.p1 * self.r1 / ((self.p1 + self.r1) or 1)

    @property
    def f2(self) -> float:
        """F-score at 2 px."""
        return 2 * self.p2 * self.r2 / ((self.p2 + self.r2) or 1)


def draw(segments: NDArray[np.floating], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W) mask of one-pixel-wide lines through (N, 2, 2) segments, px.

    End points are rounded to whole pixels (halves to even): published scores were made so, and half a point of LP0
    hangs on it.
    """
    canvas = np.zeros(shape, np.uint8)
    cv2.polylines(canvas, list(np.rint(segments).astype(np.int32)), isClosed=False, color=1)
    return canvas > 0


def distance_to(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W) Euclidean distance of every pixel to the nearest one of the mask, px; infinite for an empty mask."""
    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)


def coverage(mask: NDArray[np.bool_], distance: NDArray[np.float32], radius: float) -> float:
    """Percentage of a mask's pixels whose distance is at most `radius` px; 100 for an empty mask."""
    near = distance[mask] <= radius + 1e-3
    return 100 * float(near.mean()) if near.size else 100.0


def pixel_scores(
    segments: NDArray[np.floating],
    sparse: NDArray[np.floating],
    dense: NDArray[np.floating],
    shape: tuple[int, int],
) -> PixelScores:
    """Scores of the segments of one image.

    Nothing detected has full precision and no recall; nothing annotated is fully recalled.

    Args:
        segments: (N, 2, 2) detections, px.
        sparse: (K, 2, 2) annotation for `lp`, px.
        dense: (L, 2, 2) annotation for precision and recall, px.
        shape: (height, width) of the image.
    """
    found, few, many = (draw(lines, shape) for lines in (segments, sparse, dense))
    to_found, to_many = distance_to(found), distance_to(many)
    lp = tuple(coverage(few, to_found, radius) for radius in RADII)
    pairs = [(coverage(found, to_many, radius), coverage(many, to_found, radius)) for radius in (1, 2)]
    return PixelScores(lp, *pairs[0], *pairs[1])


def mean(scores: Sequence[PixelScores]) -> PixelScores:
    """Mean over images; its F-scores are those of the mean precision and recall."""
    lp = np.mean([s.lp for s in scores], axis=0).tolist()
    return PixelScores(tuple(lp), *np.mean([(s.p1, s.r1, s.p2, s.r2) for s in scores], axis=0).tolist())

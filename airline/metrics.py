"""Pixel-level scores of line detections against annotated lines."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

RADII = (0, 1, 2, 3, 5, 10)


@dataclass(frozen=True)
class PixelScores:
    """Scores of one image or the mean over many, in percent.

    Attributes:
        lp: Line Precision per radius of `RADII` (equation 7 of the AirLine paper: the share of annotated pixels
            within r px of a detection; a recall, so read it beside `precision`).
        precision: share of detected pixels within 2 px of an annotated one.
        recall: share of annotated pixels within 2 px of a detected one.
    """

    lp: tuple[float, ...]
    precision: float
    recall: float

    @property
    def f_score(self) -> float:
        """Harmonic mean of precision and recall."""
        total = self.precision + self.recall
        return 2 * self.precision * self.recall / total if total > 0 else 0.0


def draw(segments: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W) mask of one-pixel-wide lines through the given (N, 2, 2) segments, px."""
    canvas = np.zeros(shape, np.uint8)
    for start, end in np.rint(np.asarray(segments, np.float64) * 16).astype(int):
        cv2.line(canvas, start.tolist(), end.tolist(), 255, 1, cv2.LINE_8, 4)
    return canvas > 0


def coverage(of: NDArray[np.bool_], by: NDArray[np.bool_], radius: float) -> float:
    """Share of the pixels of one mask that lie within `radius` px (a disk) of the other mask; 1 where there are none."""
    if not of.any():
        return 1.0
    distance = cv2.distanceTransform((~by).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return float((distance[of] <= radius + 1e-3).mean()) if by.any() else 0.0


def score(
    segments: NDArray[np.float32],
    sparse: NDArray[np.float32],
    dense: NDArray[np.float32],
    shape: tuple[int, int],
) -> PixelScores:
    """Scores of the segments of one image.

    Args:
        segments: (N, 2, 2) detections, px.
        sparse: (K, 2, 2) annotation for `lp`, px.
        dense: (L, 2, 2) annotation for precision and recall, px.
        shape: (height, width) of the image.
    """
    found, few, all_lines = (draw(lines, shape) for lines in (segments, sparse, dense))
    lp = tuple(100 * coverage(few, found, radius) for radius in RADII)
    return PixelScores(lp, 100 * coverage(found, all_lines, 2), 100 * coverage(all_lines, found, 2))


def mean(scores: list[PixelScores]) -> PixelScores:
    """Mean over images."""
    lp = np.mean([s.lp for s in scores], axis=0)
    return PixelScores(
        tuple(lp.tolist()),
        float(np.mean([s.precision for s in scores])),
        float(np.mean([s.recall for s in scores])),
    )

"""Sparse optical flow of points from one image to the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.lines import scale_points

WORKING_SIZE = 480  # px; flow runs on images whose longer side is at most this: less to compute, and a wider reach
FLOW: dict[str, Any] = {
    "winSize": (9, 9),
    "maxLevel": 4,
    "criteria": (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 6, 0.03),
}
# Back again it starts from where it should end, which is all that a right flow needs.
FLOW_BACK: dict[str, Any] = {**FLOW, "maxLevel": 1, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
MAX_ROUND_TRIP = 0.5  # px of the working image, forward-backward error
JUMP = 6.0  # grey levels between the means of two images that are not the same light any more


@dataclass(frozen=True)
class WorkingImage:
    """An image reduced for optical flow.

    Attributes:
        pixels: (h, w) uint8.
        factor: px of the full image per px of this one, along both axes.
    """

    pixels: NDArray[np.uint8]
    factor: NDArray[np.float32]


def working_image(image: NDArray[np.uint8]) -> WorkingImage:
    """Reduce a (H, W) uint8 image by a power of two until its longer side is at most `WORKING_SIZE`."""
    height, width = image.shape
    halvings = max(0, int(np.ceil(np.log2(max(height, width) / WORKING_SIZE))))
    size = max(1, width >> halvings), max(1, height >> halvings)
    pixels = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if halvings else image
    return WorkingImage(np.asarray(pixels, np.uint8), np.array([width / size[0], height / size[1]], np.float32))


def flow(
    before: WorkingImage, after: WorkingImage, points: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Pyramidal Lucas-Kanade flow (Bouguet 2001) with a forward-backward check.

    Args:
        before, after: both images, of the same size.
        points: (P, 2) float32 in `before`, px of the full image.

    Returns:
        (P, 2) float32 where they are in `after`, and the (P,) mask of those that the flow back finds again.
    """
    if not len(points):
        return points, np.zeros(0, np.bool_)
    start = np.ascontiguousarray((points + 0.5) / before.factor - 0.5, np.float32)[:, None]
    first, second = same_light(before.pixels, after.pixels)
    moved, there, _ = cv2.calcOpticalFlowPyrLK(first, second, start, None, **FLOW)
    returned, back, _ = cv2.calcOpticalFlowPyrLK(second, first, moved, start.copy(), **FLOW_BACK)
    consistent = (there[:, 0] > 0) & (back[:, 0] > 0)
    consistent &= np.linalg.norm((returned - start)[:, 0], axis=1) < MAX_ROUND_TRIP
    return scale_points(moved[:, 0], before.factor).astype(np.float32), consistent


def same_light(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Both images; if the exposure jumped, the brighter one with the histogram of the darker one.

    Flow takes a point to look the same in both. A histogram says what any exposure and display curve did to the image.
    """
    rise = cv2.mean(first)[0] - cv2.mean(second)[0]
    if abs(rise) < JUMP:
        return first, second
    if rise > 0:
        return _with_histogram(first, second), second
    return first, _with_histogram(second, first)


def _with_histogram(image: NDArray[np.uint8], like: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The image with its grey levels mapped so that it has the histogram of another."""
    source, target = (np.cumsum(np.bincount(i.ravel(), minlength=256)) / i.size for i in (image, like))
    return np.interp(source, target, np.arange(256)).round().astype(np.uint8)[image]

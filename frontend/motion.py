"""Where lines go from one image to the next: sparse optical flow on points along them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

POINTS = 3  # per line
FLOW: dict[str, Any] = {
    "winSize": (11, 11),
    "maxLevel": 3,
    "criteria": (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 10, 0.03),
}
MAX_ROUND_TRIP = 1.0  # px, forward-backward error


def predict_segments(
    before: NDArray[np.uint8], after: NDArray[np.uint8], segments: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Segments of one image, moved to where they should be in the next.

    Pyramidal Lucas-Kanade flow (Bouguet 2001) with a forward-backward check moves points along each line. A line with
    at least half of its points follows their motion, fitted linearly along the line; the others follow the
    similarity that most points of the image agree on.

    Args:
        before, after: (H, W) uint8 images of the same size.
        segments: (N, 2, 2) float32 in `before`, px.

    Returns:
        (N, 2, 2) float32 in `after`, px.
    """
    if not len(segments):
        return segments
    share = ((np.arange(POINTS) + 0.5) / POINTS).astype(np.float32)
    start, delta = segments[:, None, 0], segments[:, None, 1] - segments[:, None, 0]
    points = np.ascontiguousarray(start + share[None, :, None] * delta).reshape(-1, 1, 2)
    moved, there, _ = cv2.calcOpticalFlowPyrLK(before, after, points, None, **FLOW)
    returned, back, _ = cv2.calcOpticalFlowPyrLK(after, before, moved, None, **FLOW)
    trusted = (there[:, 0] > 0) & (back[:, 0] > 0)
    trusted &= np.linalg.norm((returned - points)[:, 0], axis=1) < MAX_ROUND_TRIP
    predicted = _apply(_global_motion(points[trusted, 0], moved[trusted, 0]), segments)
    flow = (moved - points).reshape(-1, POINTS, 2)
    weight = trusted.reshape(-1, POINTS).astype(np.float32)
    follows = weight.sum(axis=1) >= POINTS / 2
    predicted[follows] = segments[follows] + _flow_at_ends(flow[follows], weight[follows], share)
    return predicted


def _flow_at_ends(
    flow: NDArray[np.float32], weight: NDArray[np.float32], share: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(K, 2, 2) flow at both ends by weighted linear regression of (K, P, 2) flow over the points' places."""
    total = weight.sum(axis=1)[:, None]
    centre = (weight * share).sum(axis=1)[:, None] / total
    mean = (weight[:, :, None] * flow).sum(axis=1) / total
    arm = weight * (share - centre)
    slope = (arm[:, :, None] * flow).sum(axis=1) / np.maximum((arm * (share - centre)).sum(axis=1)[:, None], 1e-3)
    return np.stack([mean - centre * slope, mean + (1 - centre) * slope], axis=1)


def _global_motion(before: NDArray[np.float32], after: NDArray[np.float32]) -> NDArray[np.float64]:
    """(2, 3) similarity most points agree on; the median shift of few points; the identity without any."""
    if len(before) >= 8:
        cv2.setRNGSeed(0)  # RANSAC draws from OpenCV's global generator; the same stream must give the same ids
        motion, _ = cv2.estimateAffinePartial2D(before, after, ransacReprojThreshold=3.0)
        if motion is not None:
            return np.asarray(motion, np.float64)
    shift = np.median(after - before, axis=0) if len(before) else np.zeros(2)
    return np.array([[1, 0, shift[0]], [0, 1, shift[1]]], np.float64)


def _apply(motion: NDArray[np.float64], segments: NDArray[np.float32]) -> NDArray[np.float32]:
    return (segments @ motion[:, :2].T + motion[:, 2]).astype(np.float32)

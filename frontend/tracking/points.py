"""Corners of the image followed from frame to frame, for backends that take points beside the lines."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera.model import CameraModel
from frontend.tracking.camera_motion import MAX_ERROR, Motion
from frontend.tracking.flow import WorkingImage, flow, same_light

MOST_POINTS = 200
SPACING = 0.4  # between points, over what it would be on a grid of as many; half of that once they move
QUALITY = 0.05  # of the weakest corner, over the strongest one's
BORDER = 5  # px inside the image in which a point is followed
SEARCH = 4  # px in which a corner of the working image is found in the full one
FINE: dict[str, Any] = {
    "winSize": (15, 15),
    "maxLevel": 0,
    "criteria": (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 0.01),
    "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
    "minEigThreshold": 2e-3,  # a camera's noise alone makes a corner of half that, which flow finds anywhere
}
MAX_RETURN = 0.3  # px, forward-backward error
MAX_REFINED = 1.5  # px of the working image, from where the flow there ends
MAX_OFF = 1.5  # px from where the camera's motion can bring a point,
IN_FRONT = 0.1  # of the camera, at least, on a ray of that depth
NEAREST = 10.0  # at an inverse depth up to this, where the scene has about 1


class PointTracker:
    """Follows up to `MOST_POINTS` corners by the flow of Lucas and Kanade (Bouguet 2001); a point is lost for good.

    Flow on the working image says where a point is within a pixel or two, that of the full image where exactly; both
    must lead back. One that leaves the camera's epipolar line, the image, or the space between it and an older one
    ends. New ones are the best corners of Shi and Tomasi (1994) in the gaps, placed as Foerstner and Guelch (1987) do.
    """

    def __init__(self) -> None:
        self._next_id = 0
        self._before: tuple[NDArray[np.uint8], WorkingImage] | None = None
        self.end_all()

    def end_all(self) -> None:
        """No point goes on."""
        self._ids, self._points = np.zeros(0, np.int64), np.zeros((0, 2), np.float32)

    def update(
        self, gray: NDArray[np.uint8], image: WorkingImage, camera: CameraModel, motion: Motion | None
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Take the next image.

        Args:
            gray: (H, W) uint8.
            image: the same, reduced.
            camera: of both.
            motion: of the camera since the last image, where it is known.

        Returns:
            (P,) int64 ids, ascending; (P, 2) float32 px.
        """
        spacing = SPACING * float(np.sqrt(gray.size / MOST_POINTS))
        if self._before is not None and len(self._ids):
            moved, good = _followed(*self._before, gray, image, self._points)
            good &= ((moved >= BORDER) & (moved < np.array(gray.shape[::-1]) - BORDER)).all(axis=1)
            if motion is not None and motion.error <= MAX_ERROR:
                good &= ~(_off(self._points, moved, camera, motion) > MAX_OFF)  # NaN where the lens model ends
            good[good] = _apart(moved[good], spacing / 2)
            self._ids, self._points = self._ids[good], moved[good]
        new = _corners(gray, image, self._points, spacing)
        self._ids = np.concatenate([self._ids, self._next_id + np.arange(len(new))])
        self._points = np.concatenate([self._points, new])
        self._next_id += len(new)
        self._before = gray, image
        return self._ids, self._points


def _followed(
    before: NDArray[np.uint8],
    reduced_before: WorkingImage,
    after: NDArray[np.uint8],
    reduced: WorkingImage,
    points: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(P, 2) float32 where points are in the next image, and the (P,) mask of those that were found."""
    coarse, good = flow(reduced_before, reduced, points)
    first, second = same_light(before, after)
    start = points[:, None]
    moved, there, _ = cv2.calcOpticalFlowPyrLK(first, second, start, coarse[:, None].copy(), **FINE)
    returned, back, _ = cv2.calcOpticalFlowPyrLK(second, first, moved, start.copy(), **FINE)
    good &= (there[:, 0] > 0) & (back[:, 0] > 0)
    good &= np.linalg.norm((returned - start)[:, 0], axis=1) < MAX_RETURN
    good &= (np.abs(moved[:, 0] - coarse) < MAX_REFINED * reduced.factor).all(axis=1)
    return moved[:, 0], good


def _off(
    before: NDArray[np.float32], after: NDArray[np.float32], camera: CameraModel, motion: Motion
) -> NDArray[np.float64]:
    """(P,) px by which points miss where the motion brings them from all depths: a piece of the epipolar line."""
    start, end = (camera.normalize(points).astype(np.float64) for points in (before, after))
    turned = np.column_stack([start, np.ones(len(start))]) @ motion.rotation.T
    behind = np.maximum(NEAREST * -motion.translation[2] / (turned[:, 2:] - IN_FRONT), 1)
    nearest = turned + NEAREST / behind * motion.translation
    far, near = (x[:, :2] / x[:, 2:] for x in (turned, nearest))
    way = near - far
    along = ((end - far) * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), 1e-12)
    rest = end - far - np.clip(along, 0, 1)[:, None] * way
    return np.asarray(np.hypot(rest[:, 0] * camera.fx, rest[:, 1] * camera.fy))


def _apart(points: NDArray[np.float32], least: float) -> NDArray[np.bool_]:
    """(P,) mask of those with none before them that is closer than `least`, px."""
    x, y = points.T
    close = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2 < least**2
    return np.asarray(~np.tril(close, -1).any(axis=1))


def _corners(
    gray: NDArray[np.uint8], image: WorkingImage, points: NDArray[np.float32], spacing: float
) -> NDArray[np.float32]:
    """(K, 2) float32 corners, as many as are missing, the strongest first, `spacing` px from others and from points."""
    if len(points) >= MOST_POINTS:
        return np.zeros((0, 2), np.float32)
    factor, free = image.factor, np.zeros_like(image.pixels)
    x, y = np.ceil((BORDER + SEARCH) / factor).astype(int)
    free[y:-y, x:-x] = 255
    radius = spacing / float(factor.max())
    for place in np.rint((points + 0.5) / factor - 0.5).astype(int).tolist():
        cv2.circle(free, place, round(radius), 0, -1)
    found = cv2.goodFeaturesToTrack(image.pixels, MOST_POINTS - len(points), QUALITY, radius, mask=free)
    if found is None:
        return np.zeros((0, 2), np.float32)
    start = ((found.reshape(-1, 1, 2) + 0.5) * factor - 0.5).astype(np.float32)
    exact = cv2.cornerSubPix(gray, start, (SEARCH, SEARCH), (-1, -1), (3, 10, 0.03))
    return np.asarray(exact[:, 0], np.float32)

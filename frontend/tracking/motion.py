"""Where lines go from one image to the next: sparse optical flow on points beside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.lines import scale_points

WORKING_SIZE = 480  # px; flow runs on images whose longer side is at most this: less to compute, and a wider reach
PLACES = np.array([0.25, 0.75], np.float32)  # of the points along a line
SHORT = 60.0  # px; a shorter line has one point, in its middle
BESIDE = np.array([2.0, -2.0], np.float32)  # px of the full image, to either side, where there is texture
FLOW: dict[str, Any] = {
    "winSize": (9, 9),
    "maxLevel": 4,
    "criteria": (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 6, 0.03),
}
# Back again it starts from where it should end, which is all that a right flow needs.
FLOW_BACK: dict[str, Any] = {**FLOW, "maxLevel": 1, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
MAX_ROUND_TRIP = 0.5  # px of the working image, forward-backward error
MAX_RESIDUAL = 2.0  # px of the working image, of the points that agree on the global motion
JUMP = 6.0  # grey levels between the means of two images that are not the same light any more
LEAST_POINTS = 12  # that a homography is estimated from; fewer give a shift
MOST_POINTS = 150  # for a homography; more would cost time and change nothing
GRID = (6, 4)  # of points over the whole image, so that the global motion does not hang on a few lines


@dataclass(frozen=True)
class WorkingImage:
    """An image reduced for optical flow.

    Attributes:
        pixels: (h, w) uint8.
        factor: px of the full image per px of this one, along both axes.
    """

    pixels: NDArray[np.uint8]
    factor: NDArray[np.float32]


@dataclass(frozen=True)
class Prediction:
    """Segments moved to where they should be in the next image.

    Attributes:
        segments: (N, 2, 2) float32 px.
        followed: (N,) bool, whether flow of its own points moved the line; the others moved with the image.
        homography: (3, 3) float64, the motion of the whole image, full px to full px.
        trusted: share in [0, 1] of the points whose flow was consistent.
    """

    segments: NDArray[np.float32]
    followed: NDArray[np.bool_]
    homography: NDArray[np.float64]
    trusted: float


def working_image(image: NDArray[np.uint8]) -> WorkingImage:
    """Reduce a (H, W) uint8 image by a power of two until its longer side is at most `WORKING_SIZE`."""
    height, width = image.shape
    halvings = max(0, int(np.ceil(np.log2(max(height, width) / WORKING_SIZE))))
    size = max(1, width >> halvings), max(1, height >> halvings)
    pixels = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if halvings else image
    return WorkingImage(np.asarray(pixels, np.uint8), np.array([width / size[0], height / size[1]], np.float32))


def predict_segments(
    before: WorkingImage,
    after: WorkingImage,
    segments: NDArray[np.float32],
    own: NDArray[np.bool_],
    previous: NDArray[np.float64],
) -> Prediction:
    """Move segments from one image to the next.

    Pyramidal Lucas-Kanade flow (Bouguet 2001) with a forward-backward check moves two points beside each line, one if
    it is short, and a few over the whole image. The homography that most points agree on (RANSAC) is the motion of the
    whole image: exact for a turning camera, the best guess otherwise. A line follows it, corrected by what its own
    points say beyond it.

    Args:
        before, after: both images, of the same size.
        segments: (N, 2, 2) float32 in `before`, px.
        own: (N,) bool, lines whose own points count; a hidden line's points show what hides it.
        previous: (3, 3) motion of the image before, which goes on where no point is consistent.
    """
    if not len(segments):
        return Prediction(segments, np.zeros(0, np.bool_), np.eye(3), 1.0)
    points, used = _points(segments, own)
    start = np.concatenate([points[used], _grid(before)])
    moved, consistent = _flow(before, after, start)
    homography = _global_motion(start[consistent], moved[consistent], float(before.factor.max()))
    if homography is None:
        homography = previous
    predicted = warp(homography, segments)
    count = int(used.sum())
    beyond, known = np.zeros_like(points), np.zeros(points.shape[:2], np.bool_)
    beyond[used], known[used] = (moved - warp(homography, start))[:count], consistent[:count]
    followed = np.asarray(known.any(axis=1))
    predicted[followed] += _at_ends(beyond[followed], known[followed])
    return Prediction(predicted, followed, homography, float(consistent.mean()))


def warp(homography: NDArray[np.float64], points: NDArray[np.float32]) -> NDArray[np.float32]:
    """(..., 2) points moved by a (3, 3) homography."""
    moved = points @ homography[:, :2].T + homography[:, 2]
    return (moved[..., :2] / moved[..., 2:]).astype(np.float32)


def _points(segments: NDArray[np.float32], own: NDArray[np.bool_]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(N, 2, 2) points beside each line, and the (N, 2) mask of those that are used."""
    delta = segments[:, 1] - segments[:, 0]
    length = np.maximum(np.hypot(delta[:, 0], delta[:, 1]), 1e-6)[:, None]
    across = np.stack([-delta[:, 1], delta[:, 0]], axis=1) / length
    short = length < SHORT
    places = np.where(short, np.float32(0.5), PLACES)
    points = segments[:, None, 0] + places[:, :, None] * delta[:, None] + BESIDE[:, None] * across[:, None]
    return points, own[:, None] & ~(short & [False, True])


def _grid(image: WorkingImage) -> NDArray[np.float32]:
    """Points spread over the whole image, full px."""
    height, width = image.pixels.shape
    x, y = ((np.arange(count) + 0.5) * size / count for count, size in zip(GRID, (width, height), strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return (grid * image.factor - 0.5).astype(np.float32)


def _flow(
    before: WorkingImage, after: WorkingImage, points: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(K, 2) points of the full image moved by flow, and which of them the flow back finds again."""
    start = np.ascontiguousarray((points + 0.5) / before.factor - 0.5, np.float32)[:, None]
    first, second = _same_light(before.pixels, after.pixels)
    moved, there, _ = cv2.calcOpticalFlowPyrLK(first, second, start, None, **FLOW)
    returned, back, _ = cv2.calcOpticalFlowPyrLK(second, first, moved, start.copy(), **FLOW_BACK)
    consistent = (there[:, 0] > 0) & (back[:, 0] > 0)
    consistent &= np.linalg.norm((returned - start)[:, 0], axis=1) < MAX_ROUND_TRIP
    return scale_points(moved[:, 0], before.factor).astype(np.float32), consistent


def _same_light(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
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


def _global_motion(
    before: NDArray[np.float32], after: NDArray[np.float32], factor: float
) -> NDArray[np.float64] | None:
    """(3, 3) homography most points agree on, the median shift of few points, None without any."""
    if not len(before):
        return None
    if len(before) >= LEAST_POINTS:
        every = -(-len(before) // MOST_POINTS)
        before, after = before[::every], after[::every]
        found, inliers = cv2.findHomography(before, after, cv2.RANSAC, MAX_RESIDUAL * factor, maxIters=200)
        if found is not None and inliers.sum() >= LEAST_POINTS:
            return np.asarray(found, np.float64)
    shift = np.eye(3)
    shift[:2, 2] = np.median(after - before, axis=0)
    return shift


def _at_ends(shift: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(K, 2, 2) shift at both ends: linear through both points of a line, or the one point's shift."""
    first, second = shift[:, 0], shift[:, 1]
    one = np.where(known[:, :1], first, second)
    slope = (second - first) / (PLACES[1] - PLACES[0])
    both = np.stack([first - PLACES[0] * slope, second + (1 - PLACES[1]) * slope], axis=1)
    return np.where((known[:, 0] & known[:, 1])[:, None, None], both, one[:, None])

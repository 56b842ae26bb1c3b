"""Where tracks should be in the next image: the camera's motion, each line at its own depth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.camera.model import CameraModel
from frontend.tracking.camera_motion import Motion, camera_motion
from frontend.tracking.extents import visible_parts
from frontend.tracking.flow import WorkingImage, flow
from frontend.tracking.state import DEPTH, DEPTH_ERROR, predict, slide
from frontend.tracking.table import TrackTable

PLACES = np.array([0.25, 0.75], np.float32)  # of the points along a line
SHORT = 60.0  # px; a shorter line has one point, in its middle
BESIDE = np.array([2.0, -2.0], np.float32)  # px of the full image, to either side, where there is texture
MOST_FOLLOWED, MOST_UNSURE = 500, 300  # lines that flow follows, and those whose depth is least known among them
GRID = (6, 4)  # of points over the whole image, so that the motion does not hang on a few lines
FLOW_NOISE = 0.15  # px of the working image
GUESSED_FOCAL = 0.8  # of the image's longer side, where the camera is not known
SETTLED, LEAST_SETTLED = 3, 10  # frames after which a line's depth counts for the unit of depths, and how many lines
SAME_UNIT = 0.03  # change of the unit that is not worth the work
UNITS = (0.5, 2.0)  # change of the unit from one frame to the next
MOST_DEPTH_ERROR = 0.7  # of a point for the camera's motion


@dataclass(frozen=True)
class Prediction:
    """Tracks moved to where they should be in the next image.

    Attributes:
        tracks: the tracks, without their parts that left the image; of those that left it whole nothing is cut off.
        lengths: (N,) px inside the image.
        motion: of the camera.
        trusted: share in [0, 1] of the points whose flow was consistent.
    """

    tracks: TrackTable
    lengths: NDArray[np.float64]
    motion: Motion
    trusted: float


def camera_of(camera: CameraModel | None, size: tuple[int, int]) -> CameraModel:
    """The camera, or a guess of one for images of so many px."""
    if camera is not None:
        return camera
    focal = GUESSED_FOCAL * max(size)
    return CameraModel(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)


def focal_of(camera: CameraModel) -> float:
    """Pixels per unit of the plane z = 1, in the image's middle."""
    return float(np.sqrt(camera.fx * camera.fy))


def predicted(
    tracks: TrackTable,
    before: WorkingImage,
    after: WorkingImage,
    camera: CameraModel,
    size: tuple[int, int],
    previous: Motion,
) -> Prediction:
    """Move tracks from one image to the next.

    Optical flow moves one or two points beside each line that was just seen, and a few over the whole image. The
    camera's motion is what most of them agree on, at the depths that are known by now. Each line moves with the camera,
    at its own depth, which the flow of its points tells first.
    """
    points, used, places = _points(tracks)
    start = np.concatenate([points[used], _grid(before)])
    moved, consistent = flow(before, after, start)
    planes, beyond = _to_plane(camera, np.stack([start, moved]))
    consistent &= ~beyond.any(axis=0)
    depths, errors = _depths(tracks, used, places, len(start))
    focal, noise = focal_of(camera), FLOW_NOISE * float(before.factor.max())
    trusted = [values[consistent].astype(np.float32) for values in (*planes, depths, errors)]
    motion = camera_motion(trusted[0], trusted[1], trusted[2], trusted[3], noise / focal, previous)
    flows, known = np.zeros((2, *points.shape)), np.zeros(points.shape[:2], np.bool_)
    count = int(used.sum())
    flows[:, used], known[used] = planes[:, :count], consistent[:count]
    ends, beyond = _to_plane(camera, tracks.segments)
    ends, deep, covariances, across = predict(
        ends,
        tracks.depths,
        tracks.covariances,
        places,
        (flows[0], flows[1], known),
        motion,
        focal,
        noise,
    )
    deep, covariances, motion = _in_unit(deep, covariances, motion, tracks.hits)
    segments = _to_pixels(camera, ends, beyond)
    low, high, lengths = visible_parts(segments, size)
    segments, deep, covariances = slide(segments, deep, covariances, low, high)
    part = (high - low)[:, None, None]
    gone = replace(
        tracks,
        segments=segments.astype(np.float32),
        depths=deep.astype(np.float32),
        covariances=covariances.astype(np.float32),
        ends=((tracks.ends - low[:, None, None]) / part).astype(np.float32),
        across=across.astype(np.float32),
    )
    return Prediction(gone, lengths, motion, float(consistent.mean()))


def _points(tracks: TrackTable) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.float32]]:
    """(N, 2, 2) points beside each line, the (N, 2) mask of those that are used, and their (N, 2) places along it.

    The points of a line that was not seen show what hides it. Of very many lines those are followed whose depth is
    least known, and some of the others.
    """
    segments = tracks.segments
    delta = segments[:, 1] - segments[:, 0]
    length = np.maximum(np.hypot(delta[:, 0], delta[:, 1]), 1e-6)[:, None]
    across = np.stack([-delta[:, 1], delta[:, 0]], axis=1) / length
    short = length < SHORT
    places = np.where(short, np.float32(0.5), PLACES)
    points = segments[:, None, 0] + places[:, :, None] * delta[:, None] + BESIDE[:, None] * across[:, None]
    used = tracks.visible[:, None] & ~(short & [False, True])
    visible = np.flatnonzero(tracks.visible)
    if len(visible) > MOST_FOLLOWED:
        error = tracks.covariances[visible, 2, 2] + tracks.covariances[visible, 3, 3]
        unsure = visible[np.argsort(-error, kind="stable")]
        others = unsure[MOST_UNSURE:]
        used[others[np.arange(len(others)) % -(-len(others) // (MOST_FOLLOWED - MOST_UNSURE)) != 0]] = False
    return points, used, places


def _grid(image: WorkingImage) -> NDArray[np.float32]:
    """Points spread over the whole image, full px."""
    height, width = image.pixels.shape
    x, y = ((np.arange(count) + 0.5) * size / count for count, size in zip(GRID, (width, height), strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return (grid * image.factor - 0.5).astype(np.float32)


def _depths(
    tracks: TrackTable, used: NDArray[np.bool_], places: NDArray[np.float32], count: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(count,) inverse depths of the used points and of those of the grid, and their standard deviations."""
    depths, errors = np.full(count, DEPTH, np.float32), np.full(count, DEPTH_ERROR, np.float32)
    rows, last = np.nonzero(used)[0], places[used]
    first, (near, far), P = 1 - last, tracks.depths[rows].T, tracks.covariances[rows, 2:, 2:]
    spread = first**2 * P[:, 0, 0] + 2 * first * last * P[:, 0, 1] + last**2 * P[:, 1, 1]
    depths[: len(rows)], errors[: len(rows)] = first * near + last * far, np.sqrt(np.maximum(spread, 1e-6))
    return depths, np.minimum(errors, MOST_DEPTH_ERROR)


def _in_unit(
    depths: NDArray[np.float64], covariances: NDArray[np.float64], motion: Motion, hits: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64], Motion]:
    """All in a unit in which the scene is as far away as new lines are taken to be: one camera cannot know another."""
    settled = depths[hits >= SETTLED]
    if len(settled) < LEAST_SETTLED:
        return depths, covariances, motion
    unit = float(np.clip(np.median(settled) / DEPTH, *UNITS))
    if abs(unit - 1) < SAME_UNIT:
        return depths, covariances, motion
    scale = np.array([1, 1, 1 / unit, 1 / unit])
    return depths / unit, covariances * scale * scale[:, None], replace(motion, translation=motion.translation * unit)


def _to_plane(camera: CameraModel, points: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Points on the plane z = 1, as of a pinhole camera where the lens model ends; and the mask of these."""
    pinhole = (points.astype(np.float64) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    if camera.distortion == "none":
        return pinhole, np.zeros(points.shape[:-1], np.bool_)
    plane = camera.normalize(points).astype(np.float64)
    beyond: NDArray[np.bool_] = ~np.asarray(np.isfinite(plane).all(axis=-1))
    plane[beyond] = pinhole[beyond]
    return plane, beyond


def _to_pixels(camera: CameraModel, planes: NDArray[np.float64], beyond: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The inverse of `_to_plane`; what was beyond the lens model is projected as it was then."""
    pinhole = planes * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    if camera.distortion == "none":
        return pinhole
    pixels = camera.project(planes).astype(np.float64)
    beyond = beyond | ~np.isfinite(pixels).all(axis=-1)
    pixels[beyond] = pinhole[beyond]
    return pixels

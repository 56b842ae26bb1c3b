"""A real clip with camera poses: are tracks consistent with one line in space?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError, from_extra
from frontend.evaluation.icl import FRAMES_PER_SECOND, read_image, read_numbers
from frontend.evaluation.metrics import Figures, rounded
from frontend.frame import Frame
from frontend.sources.folder import list_images

with from_extra("evaluate"):
    from scipy.optimize import least_squares

MIN_FRAMES = 5
MAX_ERROR = 2.0  # px
TINY = 1e-9
Array = NDArray[np.float64]


class PosedClip:
    """A folder as of KITTI's odometry: `images/`, `calib.txt` and `poses.txt`.

    The first row of `calib.txt` is the 3x4 projection matrix, row k of `poses.txt` image k's 3x4 world_from_camera.

    Raises:
        InputError: a folder or file is missing or malformed, or poses and images do not belong together.
    """

    def __init__(self, folder: Path) -> None:
        self.name = folder.resolve().name
        self._images = list_images(folder / "images", FRAMES_PER_SECOND)
        calibration = read_numbers(folder / "calib.txt", 12, None)
        poses = read_numbers(folder / "poses.txt", 12, None)
        if not len(calibration):
            raise InputError(f"{folder / 'calib.txt'} is empty: its first row must be the projection matrix")
        if len(poses) != len(self._images):
            raise InputError(f"{folder} has {len(self._images)} images and {len(poses)} poses: give one for each")
        self.K = calibration[0].reshape(3, 4)[:, :3]
        self.poses = poses.reshape(-1, 3, 4)

    def __len__(self) -> int:
        return len(self._images)

    def __iter__(self) -> Iterator[Frame]:
        for index, row in enumerate(self._images):
            yield Frame(index, row.stamp_ns, read_image(row.path))


@dataclass(frozen=True)
class Observation:
    """A track in one frame: (2, 2) segment, px, and the (3, 4) world_from_camera of the frame."""

    segment: NDArray[np.float32]
    pose: Array


def consistency(tracks: Sequence[Sequence[Observation]], K: Array) -> Figures:
    """How many of the tracks seen in 5 frames and more are one line in space.

    A triangulated track is consistent if the end points of all its observations are within 2 px of the reprojected
    infinite line. Lines that move by themselves never are, lines that point where the camera goes always:
    `parallax_deg` is the median angle between the farthest two planes of a track.
    """
    long = [track for track in tracks if len(track) >= MIN_FRAMES]
    good = [len(track) for track in long if reprojection_errors(track, triangulate(track, K), K).max() <= MAX_ERROR]
    figures: Figures = {
        "tracks_5": len(long),
        "consistent_tracks": len(good),
        "consistent_share": len(good) / len(long) if long else None,
        "consistent_length_mean": float(np.mean(good)) if good else None,
        "parallax_deg": float(np.median([parallax(track, K) for track in long])) if long else None,
    }
    return rounded(figures)


def triangulate(track: Sequence[Observation], K: Array) -> Array:
    """The line in space that a track's observations agree on.

    It begins as the least-squares intersection of the observations' planes, spanned by the two largest right singular
    vectors of the stacked planes (Hartley and Zisserman 2004, 12.7); Levenberg and Marquardt's method in its four
    degrees of freedom then reduces the distances of the observed end points in the images.

    Returns:
        (2, 3) a point of the line and its unit direction.
    """
    poses, segments = _arrays(track)
    centres = poses[:, :, 3]
    origin = centres.mean(axis=0)
    unit = max(float(np.linalg.norm(centres - origin, axis=1).max()), TINY)
    normals = _normals(poses, segments, K)
    offsets = np.einsum("nc,nc->n", normals, origin - centres)
    planes = np.linalg.svd(np.column_stack([normals, offsets / unit]))[2][:2]
    nearest = np.linalg.lstsq(planes[:, :3], -planes[:, 3], rcond=None)[0]
    first = _line(nearest * unit + origin, np.cross(planes[0, :3], planes[1, :3]))
    sideways = np.linalg.svd(first[1:])[2][1:]

    def moved(change: Array) -> Array:
        return _line(first[0] + unit * change[:2] @ sideways, first[1] + change[2:] @ sideways)

    def errors(change: Array) -> Array:
        return _distances(poses, segments, moved(change), K).ravel()

    return moved(least_squares(errors, np.zeros(4), method="lm", x_scale="jac", max_nfev=200).x)


def reprojection_errors(track: Sequence[Observation], line: Array, K: Array) -> Array:
    """(N, 2) distances of the observed end points to the reprojected infinite line, px."""
    return np.abs(_distances(*_arrays(track), line, K))


def parallax(track: Sequence[Observation], K: Array) -> float:
    """Largest angle between the planes of two observations, degrees."""
    normals = _normals(*_arrays(track), K)
    return float(np.rad2deg(np.arccos(np.clip(np.abs(normals @ normals.T).min(), 0, 1))))


def _arrays(track: Sequence[Observation]) -> tuple[Array, Array]:
    """(N, 3, 4) poses and (N, 2, 2) segments."""
    return np.array([o.pose for o in track]), np.array([o.segment for o in track], np.float64)


def _normals(poses: Array, segments: Array, K: Array) -> Array:
    """(N, 3) unit normals, in the world, of the planes through the camera's centre and the segment."""
    rays = np.pad(segments, ((0, 0), (0, 0), (0, 1)), constant_values=1) @ np.linalg.inv(K).T
    normals = np.einsum("nij,nj->ni", poses[:, :, :3], np.cross(rays[:, 0], rays[:, 1]))
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def _distances(poses: Array, segments: Array, line: Array, K: Array) -> Array:
    """(N, 2) signed distances of the segments' end points to the line's image, px."""
    normals = np.einsum("nij,ni->nj", poses[:, :, :3], np.cross(line[0] - poses[:, :, 3], line[1]))
    image = normals @ np.linalg.inv(K)
    across = np.einsum("nec,nc->ne", segments, image[:, :2]) + image[:, 2:]
    return np.asarray(across / np.maximum(np.hypot(image[:, 0], image[:, 1]), TINY)[:, None])


def _line(point: Array, direction: Array) -> Array:
    return np.stack([point, direction / max(float(np.linalg.norm(direction)), TINY)])

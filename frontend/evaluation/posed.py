"""Clips with known camera poses."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError, from_extra
from frontend.camera.model import CameraModel
from frontend.evaluation.icl import FRAMES_PER_SECOND, read_image, read_numbers
from frontend.frame import Frame
from frontend.sources.folder import ImageRow, list_images

with from_extra("evaluate"):
    from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]


class Posed(Protocol):
    """A clip of which the camera's (3, 3) intrinsic matrix, px, and (F, 3, 4) world_from_camera poses are known."""

    @property
    def name(self) -> str: ...

    @property
    def K(self) -> Array: ...  # noqa: N802

    @property
    def poses(self) -> Array: ...


class PosedClip:
    """A folder with images and poses, as one of these data sets has them; images have no distortion.

    - KITTI's odometry: `images/`; the first row of `calib.txt` is the 3x4 projection matrix, row k of `poses.txt` image
      k's 3x4 world_from_camera.
    - ICL-NUIM: `images/`; `calibration_matrix.txt` is the 3x3 intrinsic matrix, row k of `poses.txt` image k's
      `number x y z qx qy qz qw`.
    - TUM RGB-D: `images/` or `rgb/`, named by their stamps in s; `calib.txt` is `fx fy cx cy`, `groundtruth.txt` has
      rows `stamp x y z qx qy qz qw`. Poses are interpolated; images outside of them are left out.

    Raises:
        InputError: a folder or file is missing or malformed, or poses and images do not belong together.
    """

    def __init__(self, folder: Path) -> None:
        self.name = folder.resolve().name
        rgb = folder / "rgb"
        self._images = list_images(rgb if rgb.is_dir() else folder / "images", FRAMES_PER_SECOND)
        if (folder / "groundtruth.txt").is_file():
            fx, fy, cx, cy = _first_row(folder / "calib.txt", 4, "fx fy cx cy")
            self.K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
            self._images, self.poses = _timed_poses(folder / "groundtruth.txt", self._images)
        elif (folder / "calibration_matrix.txt").is_file():
            self.K = read_numbers(folder / "calibration_matrix.txt", 3, None)[:3]
            self.poses = _poses(read_numbers(folder / "poses.txt", 8, None)[:, 1:])
        else:
            self.K = _first_row(folder / "calib.txt", 12, "the projection matrix").reshape(3, 4)[:, :3]
            self.poses = read_numbers(folder / "poses.txt", 12, None).reshape(-1, 3, 4)
        if self.K.shape != (3, 3):
            raise InputError(f"{folder / 'calibration_matrix.txt'} is malformed: it must be 3 rows of 3 numbers")
        if len(self.poses) != len(self._images):
            raise InputError(f"{folder} has {len(self._images)} images and {len(self.poses)} poses: give one for each")

    def __len__(self) -> int:
        return len(self._images)

    def __iter__(self) -> Iterator[Frame]:
        for index, row in enumerate(self._images):
            image = read_image(row.path)
            (fx, _, cx), (_, fy, cy), _ = self.K.tolist()
            camera = CameraModel(image.shape[1], image.shape[0], abs(fx), abs(fy), cx, cy)
            yield Frame(index, row.stamp_ns, image, camera)


def _first_row(path: Path, columns: int, meaning: str) -> Array:
    rows = read_numbers(path, columns, None)
    if not len(rows):
        raise InputError(f"{path} is empty: its first row must be {meaning}")
    return np.asarray(rows[0])


def _poses(rows: Array) -> Array:
    """(N, 3, 4) of rows x y z qx qy qz qw."""
    return np.asarray(np.concatenate([Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3, None]], axis=2))


def _timed_poses(path: Path, images: list[ImageRow]) -> tuple[list[ImageRow], Array]:
    """The images taken between the first and the last pose, with their times and (N, 3, 4) poses."""
    truth = read_numbers(path, 8, None)
    try:
        stamps = np.array([float(row.path.stem) for row in images])
    except ValueError:
        raise InputError(f"images beside '{path}' must be named by their stamps in seconds") from None
    if len(truth) < 2 or (np.diff(truth[:, 0]) <= 0).any():
        raise InputError(f"{path} is malformed: it must be two poses or more in the order of time")
    inside = (stamps >= truth[0, 0]) & (stamps <= truth[-1, 0])
    stamps, images = stamps[inside], [row for row, there in zip(images, inside, strict=True) if there]
    if not images:
        raise InputError(f"no image beside '{path}' was taken while there are poses")
    places = np.stack([np.interp(stamps, truth[:, 0], column) for column in truth[:, 1:4].T], axis=1)
    turns = Slerp(truth[:, 0], Rotation.from_quat(truth[:, 4:]))(stamps).as_matrix()
    rows = [ImageRow(row.path, round(stamp * 1e9)) for row, stamp in zip(images, stamps.tolist(), strict=True)]
    return rows, np.concatenate([turns, places[:, :, None]], axis=2)

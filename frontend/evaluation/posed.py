"""Clips with known camera poses."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError, from_extra
from frontend.camera.calibration import fit_camera, read_calibration
from frontend.evaluation.icl import FRAMES_PER_SECOND, read_numbers
from frontend.frame import Frame
from frontend.sources.image_names import images_in
from frontend.sources.listing import ImageRow, list_images
from frontend.sources.stills import read_image

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

    - KITTI's odometry: `images/`, `calib.txt`; row k of `poses.txt` is image k's 3x4 world_from_camera.
    - ICL-NUIM: `images/`, `calibration_matrix.txt`; row k of `poses.txt` is image k's `number x y z qx qy qz qw`.
    - TUM RGB-D: `images/` or `rgb/`, named by their stamps in s; `calib.txt`; `groundtruth.txt` has rows
      `stamp x y z qx qy qz qw`. Poses are interpolated; images outside of them are left out.

    Raises:
        InputError: a folder or file is missing or malformed, or poses and images do not belong together.
    """

    def __init__(self, folder: Path) -> None:
        self.name = folder.resolve().name
        rgb = folder / "rgb"
        images = rgb if rgb.is_dir() else folder / "images"
        self._images = list_images(images, FRAMES_PER_SECOND).rows
        is_icl = (folder / "calibration_matrix.txt").is_file()
        found = read_calibration(folder / ("calibration_matrix.txt" if is_icl else "calib.txt"))
        self._camera, self.K = found.camera, found.camera.matrix
        if self._camera.distortion != "none":
            raise InputError(f"'{found.file}' has a lens distortion: give undistorted images and their camera")
        if found.y_up:
            self.K[1, 1] *= -1
        if (folder / "groundtruth.txt").is_file():
            self._images, self.poses = _timed_poses(folder / "groundtruth.txt", images_in(images))
        elif is_icl:
            self.poses = _poses(read_numbers(folder / "poses.txt", 8, None)[:, 1:])
        else:
            self.poses = read_numbers(folder / "poses.txt", 12, None).reshape(-1, 3, 4)
        if len(self.poses) != len(self._images):
            raise InputError(f"{folder} has {len(self._images)} images and {len(self.poses)} poses: give one for each")

    def __len__(self) -> int:
        return len(self._images)

    def __iter__(self) -> Iterator[Frame]:
        for index, row in enumerate(self._images):
            image = read_image(row.path)
            self._camera = fit_camera(self._camera, image.shape[1], image.shape[0])
            yield Frame(index, row.stamp_ns, image, self._camera)


def _poses(rows: Array) -> Array:
    """(N, 3, 4) of rows x y z qx qy qz qw."""
    return np.asarray(np.concatenate([Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3, None]], axis=2))


def _timed_poses(path: Path, images: list[Path]) -> tuple[list[ImageRow], Array]:
    """The images taken between the first and the last pose, with their times and (N, 3, 4) poses."""
    truth = read_numbers(path, 8, None)
    try:
        stamps = np.array([float(path.stem) for path in images])
    except ValueError:
        raise InputError(f"images beside '{path}' must be named by their stamps in seconds") from None
    if len(truth) < 2 or (np.diff(truth[:, 0]) <= 0).any():
        raise InputError(f"{path} is malformed: it must be two poses or more in the order of time")
    inside = (stamps >= truth[0, 0]) & (stamps <= truth[-1, 0])
    stamps, images = stamps[inside], [path for path, there in zip(images, inside, strict=True) if there]
    if not images:
        raise InputError(f"no image beside '{path}' was taken while there are poses")
    places = np.stack([np.interp(stamps, truth[:, 0], column) for column in truth[:, 1:4].T], axis=1)
    turns = Slerp(truth[:, 0], Rotation.from_quat(truth[:, 4:]))(stamps).as_matrix()
    rows = [ImageRow(path, round(stamp * 1e9)) for path, stamp in zip(images, stamps.tolist(), strict=True)]
    return rows, np.concatenate([turns, places[:, :, None]], axis=2)

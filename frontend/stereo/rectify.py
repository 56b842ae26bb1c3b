"""Rectified pairs: both images as cameras would see them that stand beside each other and look the same way.

The rows of both are then the same (Fusiello, Trucco and Verri, 2000): x goes along the baseline, and z is as near to
both cameras' axes as that allows. The new images have no lens, the left one's size and no black borders.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from frontend.camera.model import CameraModel
from frontend.camera.rig import inverse
from frontend.camera.undistort import covers, filled_camera, maps_between, remapped
from frontend.sources.reading import Image

Array = NDArray[np.float64]

NO_PLACES = (
    "the calibration does not say where the two cameras are: give that of both with --calib and --right-calib "
    "(EuRoC's T_BS, a Kalibr camchain, KITTI's P0 to P3, ROS's P), or say --rectified where both have the same rows"
)

_STEEP = 0.01  # rows per column of a rectified pair's baseline: KITTI's colour cameras have 0.006
_TURNED = 1e-4  # entries of the rotation between its cameras, a twentieth of a pixel
_OFF = 0.05  # px, between their principal points' rows, and of their focal lengths
_TILTED = 0.71  # cosine of the angle between the axes of two cameras that are no pair


class Rectifier:
    """Rectifies the images of two cameras; those of a pair that is rectified by its calibration stay as they are.

    Args:
        left, right: the cameras, for images of the same size.
        rectified: the images are, whatever the calibration knows; without `rig_from_camera` there is no baseline then.

    Attributes:
        camera: the left one of the rectified pair.
        remaps: whether images are changed.

    Raises:
        InputError: the calibration is none of a pair, or one whose cameras are the wrong way round.
    """

    def __init__(self, left: CameraModel, right: CameraModel | None, *, rectified: bool = False) -> None:
        self._maps = None
        self.camera = left
        if rectified and left.distortion != "none":
            raise InputError(
                "--rectified says that the images have no lens distortion, and their calibration has some: leave "
                "--rectified out, or leave the calibration out with --calib none"
            )
        if right is None or left.rig_from_camera is None or right.rig_from_camera is None:
            if not rectified:
                raise InputError(NO_PLACES)
            return
        left_from_right = inverse(left.rig_from_camera) @ right.rig_from_camera
        turn, baseline = left_from_right[:3, :3], left_from_right[:3, 3]
        _check_places(turn, baseline)
        if _is_rectified(left, right, turn, baseline):
            offset = left.cx - right.cx
            self.camera = replace(left, baseline_m=float(baseline[0]), disparity_offset=offset)
            return
        if rectified:
            raise InputError(
                "--rectified says that the images have the same rows, and by the calibration they do not: leave "
                "--rectified out, or leave the calibration out with --calib none"
            )
        x = baseline / np.linalg.norm(baseline)
        y = np.cross(turn[:, 2] + (0, 0, 1), x)
        y /= np.linalg.norm(y)
        left_from_new = np.stack([x, y, np.cross(x, y)], axis=1)
        turns = left_from_new, turn.T @ left_from_new
        middle = np.array([left.width - 1, left.height - 1]) / 2
        rays = [
            np.append(camera.normalize(middle), 1) @ turn for camera, turn in zip((left, right), turns, strict=True)
        ]
        centre = np.mean([ray[:2] / ray[2] for ray in rays], axis=0)
        new = filled_camera(left, centre, lambda plane: all(map(covers, (left, right), (plane, plane), turns)))
        if new is None:
            raise InputError("by their calibration the two cameras see nothing in common: check which is which")
        self._maps = tuple(maps_between(camera, new, turn) for camera, turn in zip((left, right), turns, strict=True))
        self.camera = replace(new, baseline_m=float(np.linalg.norm(baseline)))

    @property
    def remaps(self) -> bool:
        return self._maps is not None

    def __call__(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Both images, (H, W[, 3]) uint8 or uint16, of the cameras' size."""
        if self._maps is None:
            return left, right
        return remapped(left, self._maps[0]), remapped(right, self._maps[1])


def _check_places(turn: Array, baseline: Array) -> None:
    """Refuse cameras that do not stand beside each other; of the right one as the left one sees it."""
    x, y, z = np.abs(baseline)
    if not np.linalg.norm(baseline):
        raise InputError("the calibration has both cameras in the same place: give that of a stereo pair")
    if y > x or z > x or turn[2, 2] < _TILTED:
        how = "look different ways" if turn[2, 2] < _TILTED else "are not beside but above or behind each other"
        raise InputError(f"by their calibration the two cameras {how}, and a pair's rows must run along its baseline")
    if baseline[0] < 0:
        raise InputError("by the calibration the right camera stands to the left of the left one: swap the two")


def _is_rectified(left: CameraModel, right: CameraModel, turn: Array, baseline: Array) -> bool:
    off = max(abs(left.fx - right.fx), abs(left.fy - right.fy), abs(left.cy - right.cy))
    return bool(
        left.distortion == right.distortion == "none"
        and off < _OFF
        and np.abs(turn - np.eye(3)).max() < _TURNED
        and np.abs(baseline[1:]).max() < _STEEP * baseline[0]
    )

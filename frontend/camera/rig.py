"""Where the cameras of a calibration are: rigid motions (4, 4) from a camera's frame to one that all of them share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from frontend.camera.model import LARGEST
from frontend.space import is_rigid

Array = NDArray[np.float64]


def rigid(numbers: Any, what: str) -> Array:
    """(4, 4) of a rotation and a translation in m, from 16 numbers, or (3, 4) of them; raises InputError for others."""
    try:
        values = np.array(numbers, np.float64).ravel()
    except (ValueError, TypeError, OverflowError):
        values = np.zeros(0)
    if values.size == 12:
        values = np.append(values, (0, 0, 0, 1))
    if values.size == 16 and (np.abs(values) <= LARGEST).all():  # false for NaN
        motion = values.reshape(4, 4)
        if is_rigid(motion):
            return motion
    raise InputError(f"{what} is no rotation with a translation: it must be 4x4 numbers, the last row 0 0 0 1")


def inverse(motion: Array) -> Array:
    """Of a rigid motion (4, 4)."""
    turn, found = motion[:3, :3].T, np.eye(4)
    found[:3, :3], found[:3, 3] = turn, -turn @ motion[:3, 3]
    return found


def rig_of_projection(projection: Sequence[float], rectification: Sequence[float] = ()) -> Array | None:
    """Of a camera whose rectified image has the projection K [I | t], as KITTI and ROS write it.

    Args:
        projection: 12 numbers, row by row.
        rectification: 9 of the rotation from the camera's frame to that of its rectified image; none for that image.

    Returns:
        The motion to the frame of all rectified images; None where the numbers are missing or, as of a camera that is
        not calibrated, zeros.
    """
    if len(projection) != 12 or not projection[0] * projection[5] or (len(rectification) and not any(rectification)):
        return None
    fx, _, cx, x, _, fy, cy, y, *_, z = projection
    centre = -(x - cx * z) / fx, -(y - cy * z) / fy, -z
    turn = np.reshape(rectification, (3, 3)) if len(rectification) == 9 else np.eye(3)
    return rigid(np.column_stack([turn, centre]), "the calibration's rectification")


def rigs_of_chain(chain: Mapping[str, Mapping[str, Any]]) -> dict[str, Array | None]:
    """Of each camera in Kalibr's camchain, whose order is that of the mapping: by `T_cn_cnm1`, else by `T_cam_imu`."""
    first, *others = chain
    if others and all("T_cn_cnm1" in chain[name] for name in others):
        rigs: dict[str, Array | None] = {first: np.eye(4)}
        motion = np.eye(4)
        for name in others:
            motion = rigid(chain[name]["T_cn_cnm1"], f"{name}.T_cn_cnm1") @ motion
            rigs[name] = inverse(motion)
        return rigs
    if all("T_cam_imu" in camera for camera in chain.values()):
        return {name: inverse(rigid(camera["T_cam_imu"], f"{name}.T_cam_imu")) for name, camera in chain.items()}
    return dict.fromkeys(chain)

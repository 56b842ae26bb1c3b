"""What is known in space: checks of rigid motions, and of lines that are handed to sinks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError


def is_rigid(motion: NDArray[np.float64]) -> bool:
    """Whether it is a (4, 4) rotation and translation, up to the digits that files have of it."""
    if motion.shape != (4, 4) or not np.isfinite(motion).all():
        return False
    turn = motion[:3, :3]
    near = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.allclose(motion[3], (0, 0, 0, 1))
    return bool(near and np.linalg.det(turn) > 0)


def checked_pose(world_T_camera: NDArray[np.floating]) -> NDArray[np.float64]:
    """A (4, 4) rigid motion as float64; InputError where it is none."""
    pose = np.asarray(world_T_camera, np.float64)
    if not is_rigid(pose):
        raise InputError("a pose must be a (4, 4) matrix of rotation and translation, from camera to world")
    return pose


def checked_lines(segments: NDArray[np.floating], ids: NDArray[np.int64]) -> NDArray[np.float32]:
    """(N, 2, 3) end points as float32; InputError where they do not fit to N ids."""
    lines = np.asarray(segments, np.float32)
    if np.asarray(ids).dtype.kind not in "iu" or not np.isfinite(lines).all():
        raise InputError("lines in space must be finite, and their ids whole numbers")
    if lines.shape != (len(ids), 2, 3):
        raise InputError(f"lines in space must be (N, 2, 3) with N ids, not {lines.shape} with {len(ids)} ids")
    return lines

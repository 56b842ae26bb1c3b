"""What is known in space: checks of poses and of lines that are handed to sinks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError


def checked_pose(world_T_camera: NDArray[np.floating]) -> NDArray[np.float64]:
    """A (4, 4) rigid motion as float64; InputError where it is none."""
    pose = np.asarray(world_T_camera, np.float64)
    turn = pose[:3, :3]
    if (
        pose.shape != (4, 4)
        or not np.isfinite(pose).all()
        or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3)
        or np.linalg.det(turn) < 0
    ):
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

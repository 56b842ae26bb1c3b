"""The camera, its poses and lines in space."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from airline.errors import InputError
from frontend.camera.model import CameraModel
from frontend.colours import track_colours
from viz.strips import packed, strips_3d


def pinhole(camera: CameraModel) -> rr.Pinhole:
    """The camera at `/camera`: only the intrinsics, as Rerun has no lens distortion."""
    return rr.Pinhole(
        focal_length=(camera.fx, camera.fy),
        principal_point=(camera.cx + 0.5, camera.cy + 0.5),
        width=camera.width,
        height=camera.height,
        image_plane_distance=0.5,
    )


def log_world(stream: rr.RecordingStream) -> None:
    """Log, once, how the world is shown: upright where it is the frame of a first camera held upright."""
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)


class Poses:
    """Logs where the camera is, and the way it came."""

    def __init__(self) -> None:
        self._before: NDArray[np.float32] | None = None

    def log(self, stream: rr.RecordingStream, world_T_camera: NDArray[np.floating]) -> None:
        """Log a pose at the stream's present time.

        Raises:
            InputError: it is no (4, 4) rigid motion.
        """
        pose = np.asarray(world_T_camera, np.float64)
        rigid = pose.shape == (4, 4) and np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-3)
        if not rigid or not np.isfinite(pose).all():
            raise InputError("a pose must be a (4, 4) matrix of rotation and translation, from camera to world")
        place = pose[:3, 3].astype(np.float32)
        stream.log("/camera", rr.Transform3D(translation=place, mat3x3=pose[:3, :3]))
        before = place if self._before is None else self._before
        step = strips_3d(np.stack([before, place])[None])
        stream.log("/world/path", rr.LineStrips3D(step, colors=(255, 255, 255), radii=rr.Radius.ui_points(1)))
        self._before = place


def log_lines_3d(stream: rr.RecordingStream, segments: NDArray[np.floating], ids: NDArray[np.int64]) -> None:
    """Log lines in space at the stream's present time, in the colours of their tracks.

    Raises:
        InputError: segments and ids do not fit together.
    """
    lines = np.asarray(segments, np.float32)
    if lines.shape != (len(ids), 2, 3):
        raise InputError(f"lines in space must be (N, 2, 3) with N ids, not {lines.shape} with {len(ids)} ids")
    strips = rr.LineStrips3D(strips_3d(lines), colors=packed(track_colours(ids)), radii=rr.Radius.ui_points(1.5))
    stream.log("/world/lines", strips, rr.AnyValues(track_id=ids))

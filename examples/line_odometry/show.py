"""The path and the lines in space, for the Rerun viewer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from line_odometry.clips import Seen
from line_odometry.score import Aligned
from line_odometry.views import Array

TRUTH, OURS, LINES = (120, 120, 120), (80, 200, 120), (90, 170, 255)
FRUSTUM = 0.25  # of the path's extent


def show(save: Path, seen: Seen, segments: Array, path: Aligned | None = None) -> None:
    """Write lines (N, 2, 3) beside the true ones, and the path that they were found with, where it is estimated."""
    recording = rr.RecordingStream("airline-odometry")
    view = rrb.Spatial3DView(
        origin="world", name="lines and path: true grey, estimated coloured", background=(20, 22, 26)
    )
    recording.save(save, default_blueprint=rrb.Blueprint(view, collapse_panels=True))
    recording.log("world", getattr(rr.ViewCoordinates, seen.axes), static=True)
    recording.log("world/true_path", _path(seen.poses, TRUTH, 1.0), static=True)
    if seen.lines is not None:
        recording.log("world/true_lines", _strips(seen.lines.visible, TRUTH), static=True)
    if path is not None:
        segments = path.scale * segments @ path.turn.T + path.shift
        recording.log("world/path", _path(path.poses, OURS, 3.0), static=True)
        reach = FRUSTUM * float(np.ptp(seen.poses[:, :, 3], axis=0).max())
        camera = rr.Pinhole(focal_length=1.0, width=1.1, height=0.8, image_plane_distance=reach)
        recording.log("world/camera", camera, static=True)
        for index, pose in enumerate(path.poses):
            recording.set_time("frame", sequence=index)
            recording.log("world/camera", rr.Transform3D(translation=pose[:, 3], mat3x3=pose[:, :3]))
    recording.log("world/lines", _strips(segments, LINES), static=True)
    recording.flush()
    recording.disconnect()


def _path(poses: Array, colour: tuple[int, int, int], width: float) -> rr.LineStrips3D:
    return rr.LineStrips3D([poses[:, :, 3]], colors=[colour], radii=rr.Radius.ui_points(width))


def _strips(segments: Array, colour: tuple[int, int, int]) -> rr.LineStrips3D:
    return rr.LineStrips3D(segments, colors=[colour] * len(segments), radii=rr.Radius.ui_points(1.0))

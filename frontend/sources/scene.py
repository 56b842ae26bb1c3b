"""Rendered scenes as sources of frames, and the built-in clip: one of them as a small video, with its truth beside it.

Beside `clip/corridor.mp4` lie the camera as `camera.json`, both also of a second camera to its right
(`corridor_right.mp4`, `camera_right.json`), and `poses.txt` with a row "time x y z qx qy qz qw" per frame, world from
left camera, in s and m, as TUM's trajectories are written. `tests/helpers/built_in_clip.py` renders it anew.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from frontend.camera.calibration import read_calibration
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.stereo import StereoSource
from frontend.sources.video import VideoSource
from frontend.sources.wrapped import CalibratedFrames, WrappedSource

if TYPE_CHECKING:
    from airline.scenes import RenderedClip, RenderedView

CLIP = Path(__file__).with_name("clip") / "corridor.mp4"
"""A hand-held walk of ten seconds along a corridor, 640x480."""

CAMERAS = ("", "_right")


class BuiltInClip(WrappedSource):
    """Frames of the built-in clip, with their camera.

    Args:
        stereo: with the right camera's images.
    """

    kind = "built-in clip"

    def __init__(self, *, stereo: bool = False) -> None:
        cameras = [_camera(of) for of in (CAMERAS if stereo else CAMERAS[:1])]
        super().__init__(StereoSource(*cameras) if stereo else cameras[0])

    def __iter__(self) -> Iterator[Frame]:
        return iter(self._source)


def _camera(of: str) -> Source:
    return CalibratedFrames(VideoSource(beside(CLIP, of)), read_calibration(beside(CLIP, of, "camera.json")).camera)


class SceneSource(Source):
    """Frames of a rendered clip, rendered while it runs.

    Args:
        clip: it.
        stereo: with the right camera's images.
    """

    name: str
    kind = "rendered clip"
    frame_count: int

    def __init__(self, clip: RenderedClip, *, stereo: bool = False) -> None:
        self._clip, self._stereo = clip, stereo
        self.name = f"{self._clip.kind}-{self._clip.motion}"
        self.frame_count = len(self._clip)

    def __iter__(self) -> Iterator[Frame]:
        from airline.scenes import render_clip, render_pairs

        if self._stereo:
            yield from (frame_of(index, *pair) for index, pair in enumerate(render_pairs(self._clip)))
        else:
            yield from (frame_of(index, view) for index, view in enumerate(render_clip(self._clip)))


def frame_of(index: int, view: RenderedView, right: RenderedView | None = None) -> Frame:
    """A rendered view, or a pair of them, as a frame with its camera."""
    height, width = view.depth.shape
    fx, fy, cx, cy = view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2]
    baseline = 0.0 if right is None else round(float((right.pose[:3, 3] - view.pose[:3, 3]) @ view.pose[:3, 0]), 9)
    camera = CameraModel(width, height, fx, fy, cx, cy, baseline_m=baseline)
    return Frame(index, view.stamp_ns, view.image, camera, right=None if right is None else right.image)


def beside(video: Path, of: str, name: str = "") -> Path:
    """The file of a camera beside a video; by default its video."""
    file = video.with_name(name or video.name)
    return file.with_stem(file.stem + of)

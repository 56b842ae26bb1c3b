"""The built-in clip: a rendered scene as a source of frames."""

from __future__ import annotations

from collections.abc import Iterator

from airline.scenes import RenderedClip, RenderedView, render_clip
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.protocols import Source


def frame_of(index: int, view: RenderedView) -> Frame:
    """A rendered view as a frame with its camera."""
    height, width = view.depth.shape
    fx, fy, cx, cy = view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2]
    return Frame(index, view.stamp_ns, view.image, CameraModel(width, height, fx, fy, cx, cy))


class SceneSource(Source):
    """Frames of a rendered clip; the default is a hand-held walk of ten seconds along a corridor."""

    name: str
    kind = "rendered clip"
    frame_count: int

    def __init__(self, clip: RenderedClip | None = None) -> None:
        self._clip = clip or RenderedClip(kind="indoor", motion="handheld", seed=12, frames=300)
        self.name = f"{self._clip.kind}-{self._clip.motion}"
        self.frame_count = len(self._clip)

    def __iter__(self) -> Iterator[Frame]:
        for index, view in enumerate(render_clip(self._clip, workers=2)):
            yield frame_of(index, view)

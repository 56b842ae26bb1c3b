"""The built-in clip: a rendered scene as a source of frames."""

from __future__ import annotations

from collections.abc import Iterator

from airline.scenes import RenderedClip, RenderedView, render_clip
from frontend.camera.model import CameraModel
from frontend.frame import Frame


def frame_of(index: int, view: RenderedView) -> Frame:
    """A rendered view as a frame with its camera."""
    height, width = view.depth.shape
    fx, fy, cx, cy = view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2]
    return Frame(index, view.stamp_ns, view.image, CameraModel(width, height, fx, fy, cx, cy))


class SceneSource:
    """Frames of a rendered sequence, with its camera."""

    def __init__(self, sequence: RenderedClip | None = None) -> None:
        """Stream a sequence; the default is a hand-held walk of ten seconds along a corridor."""
        self._sequence = sequence or RenderedClip(kind="indoor", motion="handheld", seed=12, frames=300)

    @property
    def name(self) -> str:
        """Short name, for progress bars and file names."""
        return f"{self._sequence.kind}-{self._sequence.motion}"

    @property
    def frame_count(self) -> int:
        """How many frames the sequence has."""
        return len(self._sequence)

    @property
    def skipped(self) -> int:
        """Always 0: nothing can be unreadable."""
        return 0

    def __iter__(self) -> Iterator[Frame]:
        for index, view in enumerate(render_clip(self._sequence, workers=2)):
            yield frame_of(index, view)

    def close(self) -> None:
        """Nothing to release."""

"""Rendered clips: exact identities, because the world is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from airline.scenes import CameraEffects, RenderedClip
from frontend.evaluation.clip import Clip, Truth
from frontend.evaluation.occluder import Occluder
from frontend.frame import Frame
from frontend.sources.scene import frame_of

FRAMES = 120
EXPOSURES = (0.7, 1.4, 0.7, 0.35)
DARK = CameraEffects(exposure=0.06, noise_sigma=8.0)


@dataclass(frozen=True)
class LabelledClip:
    """A generated sequence whose camera settings may jump, and something that may pass before the camera.

    Frames are rendered one by one in the caller's thread, so that timings of the tracker are not disturbed.

    Attributes:
        name: as the command line and the JSON name it.
        takes: sequences that differ in `effects` alone; each is shown for `hold` frames before the next, in turns.
        hold: frames.
        occluder: what passes before the camera, if anything does.
    """

    name: str
    takes: tuple[RenderedClip, ...]
    hold: int = 12
    occluder: Occluder | None = None

    def __len__(self) -> int:
        return len(self.takes[0])

    def __iter__(self) -> Iterator[tuple[Frame, Truth]]:
        return (self.at(i) for i in range(len(self)))

    def at(self, i: int) -> tuple[Frame, Truth]:
        """Frame `i` and its lines; IndexError outside of the clip."""
        view = self.takes[i // self.hold % len(self.takes)].render(i)
        frame, truth = frame_of(i, view), Truth(view.segments_px, view.ids)
        return (frame, truth) if self.occluder is None else self.occluder.cover(frame, truth)


def _take(
    kind: str, motion: str, seed: int, frames: int = FRAMES, effects: CameraEffects | None = None
) -> RenderedClip:
    """A sequence whose truth has every line a detector might see, so that what may be either of two is known to be."""
    return RenderedClip(
        kind, motion, seed, frames, effects=effects or CameraEffects(), min_contrast=1.0, merge_doubles=False
    )


def rendered_clips() -> list[Clip]:
    """The eight rendered clips, 640x480.

    "fast" turns at up to 1.7 rad/s: the image moves by 18 px per frame in the mean and up to 30 px in its centre, up
    to 45 px in its corners. "dark" has a sixteenth of the light, which is about a quarter of the grey levels.
    """
    jumps = tuple(_take("street", "handheld", 5, effects=CameraEffects(exposure=e)) for e in EXPOSURES)
    return [
        LabelledClip("static", (_take("indoor", "static", 7, 60),)),
        LabelledClip("slow", (_take("street", "slow", 4),)),
        LabelledClip("handheld", (_take("indoor", "handheld", 3),)),
        LabelledClip("fast", (_take("indoor", "fast", 4),)),
        LabelledClip("dark", (_take("indoor", "handheld", 12, effects=DARK),)),
        LabelledClip("exposure", jumps),
        LabelledClip("occlusion", (_take("street", "handheld", 6),), occluder=Occluder()),
        LabelledClip("repeated", (_take("shelves", "handheld", 4),)),
    ]

"""Rendered clips: exact identities, because the world is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.scenes import CameraEffects, RenderedClip
from airline.scenes.visibility import MIN_LENGTH
from frontend.evaluation.truth import Clip, Truth
from frontend.frame import Frame
from frontend.sources.scene import frame_of

FRAMES = 120
HOLD = 12  # frames between jumps of the exposure
EXPOSURES = (0.7, 1.4, 0.7, 0.35)
LIGHT = CameraEffects()
DARK = CameraEffects(exposure=0.06, noise_sigma=8.0)
PERIOD, SPEED, RADIUS = 40, 24.0, 62.0  # of what passes before the camera: frames; px per frame; px, of a disc
NOISE = 2.5  # grey levels, as the renderer's camera has


@dataclass(frozen=True)
class SceneClip:
    """A rendered clip, in the caller's thread so that the tracker's timings are not disturbed.

    Attributes:
        name: as the command line and the JSON name it.
        takes: clips that differ in `effects` alone, each shown for `HOLD` frames in turns.
        occluded: whether something passes before the camera.
    """

    name: str
    takes: tuple[RenderedClip, ...]
    occluded: bool = False

    def __len__(self) -> int:
        return len(self.takes[0])

    def __iter__(self) -> Iterator[tuple[Frame, Truth]]:
        return map(self.at, range(len(self)))

    @property
    def K(self) -> NDArray[np.float64]:  # noqa: N802
        """(3, 3) intrinsic matrix, px."""
        return self.takes[0].K

    @cached_property
    def poses(self) -> NDArray[np.float64]:
        """(F, 3, 4) world_from_camera."""
        return np.array([self.takes[0].pose(i)[:3] for i in range(len(self))])

    def at(self, i: int) -> tuple[Frame, Truth]:
        """Frame `i` and its lines; IndexError outside of the clip."""
        view = self.takes[i // HOLD % len(self.takes)].render(i)
        frame, truth = frame_of(i, view), Truth(view.segments_px, view.ids)
        return occlude(frame, truth) if self.occluded else (frame, truth)


def _take(kind: str, motion: str, seed: int, frames: int = FRAMES, effects: CameraEffects = LIGHT) -> RenderedClip:
    """A clip whose truth has every line a detector might see, so that what may be either of two is known to be."""
    return RenderedClip(kind, motion, seed, frames, effects=effects, min_contrast=1.0, merge_doubles=False)


def rendered_clips() -> list[Clip]:
    """The eight rendered clips, 640x480.

    "fast" turns at up to 1.7 rad/s: 18 px per frame in the mean, up to 30 px in the image's centre and 45 px in its
    corners. "dark" has a sixteenth of the light, about a quarter of the grey levels.
    """
    jumps = tuple(_take("street", "handheld", 5, effects=CameraEffects(exposure=e)) for e in EXPOSURES)
    return [
        SceneClip("static", (_take("indoor", "static", 7, 60),)),
        SceneClip("slow", (_take("street", "slow", 4),)),
        SceneClip("handheld", (_take("indoor", "handheld", 3),)),
        SceneClip("fast", (_take("indoor", "fast", 4),)),
        SceneClip("dark", (_take("indoor", "handheld", 12, effects=DARK),)),
        SceneClip("exposure", jumps),
        SceneClip("occlusion", (_take("street", "handheld", 6),), occluded=True),
        SceneClip("repeated", (_take("shelves", "handheld", 4),)),
    ]


def occluder_discs(i: int, width: int, height: int) -> NDArray[np.float64]:
    """(D, 2) centres of the discs that hide something in frame `i` of images of width x height px, about 640x480.

    A bunch of discs, without any straight line, crosses the image every 40 frames, from the left and right in turns.
    """
    crossing, t = divmod(i, PERIOD)
    rng = np.random.default_rng([0, crossing])
    grid = np.stack(np.meshgrid((-1.1, 0.0, 1.1), (-2.4, -1.2, 0.0, 1.2, 2.4)), axis=-1).reshape(-1, 2)
    bunch = RADIUS * (grid + rng.uniform(-0.12, 0.12, grid.shape))
    travelled = SPEED * t - 2.2 * RADIUS
    x = travelled if crossing % 2 == 0 else width - 1 - travelled
    y = height * rng.uniform(0.4, 0.6)
    return np.asarray(bunch + (x, y))


def occlude(frame: Frame, truth: Truth) -> tuple[Frame, Truth]:
    """The frame with the discs drawn into it, and the lines that stay visible."""
    height, width = frame.image.shape[:2]
    discs = occluder_discs(frame.index, width, height)
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    nearest = np.full((height, width), np.inf, np.float32)
    for cx, cy in discs.astype(np.float32):
        np.minimum(nearest, (x - cx) ** 2 + (y - cy) ** 2, out=nearest)
    alpha = np.clip(RADIUS + 0.5 - np.sqrt(nearest), 0, 1).astype(np.float32)
    # The texture moves with the discs by fractions of a pixel, too.
    (left, top), texture = discs.mean(axis=0).astype(np.float32), _clouds()
    own_x, own_y = np.broadcast_arrays((x - left) % len(texture), (y - top) % len(texture))
    coat = cv2.remap(texture, own_x.copy(), own_y.copy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    rng = np.random.default_rng([0, frame.index, 1])
    coat = coat + NOISE * rng.standard_normal(coat.shape, np.float32)
    mixed = frame.image + alpha[..., None] * (coat - frame.image)
    image = np.clip(np.round(mixed), 0, 255).astype(np.uint8)
    pieces, rows = cut_by_discs(truth.segments_px, discs, RADIUS)
    return replace(frame, image=image), Truth(pieces, truth.ids[rows])


@cache
def _clouds() -> NDArray[np.float32]:
    """(256, 256, 3) float32 seamless BGR pattern without lines."""
    noise = np.random.default_rng([0, 2]).standard_normal((256, 256, 2)).astype(np.float32)
    clouds = np.zeros_like(noise)
    for sigma in (9.0, 20.0):
        blurred = cv2.GaussianBlur(np.tile(noise, (3, 3, 1)), (0, 0), sigma)[256:512, 256:512]
        clouds += blurred / blurred.std()
    brown, tint = np.array([60, 95, 125], np.float32), np.array([-6, 2, 6], np.float32)
    return np.asarray(brown * (1 + 0.09 * clouds[..., :1]) + tint * clouds[..., 1:], np.float32)


def cut_by_discs(
    segments: NDArray[np.float32], centres: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """The parts of segments (N, 2, 2) outside of discs around centres (D, 2), px.

    Returns:
        (K, 2, 2) float32 pieces at least as long as the renderer's shortest line; (K,) int64 rows of `segments`.
    """
    pieces: list[NDArray[np.float64]] = []
    rows: list[int] = []
    for row, (start, end) in enumerate(np.asarray(segments, np.float64)):
        delta = end - start
        length = float(np.hypot(*delta))
        along = (centres - start) @ delta / length**2
        across = np.abs((centres[:, 0] - start[0]) * delta[1] - (centres[:, 1] - start[1]) * delta[0]) / length
        half = np.sqrt(np.maximum(radius**2 - across**2, 0)) / length
        hits = across < radius
        reached = 0.0
        for low, high in [*sorted(zip(along[hits] - half[hits], along[hits] + half[hits], strict=True)), (1.0, 1.0)]:
            stop = min(low, 1.0)
            if (stop - reached) * length >= MIN_LENGTH:
                pieces.append(start + np.array([[reached], [stop]]) * delta)
                rows.append(row)
            reached = max(reached, high)
    return np.asarray(pieces, np.float32).reshape(-1, 2, 2), np.asarray(rows, np.int64)

"""Something that passes before the camera, with the exact part of every line that it hides."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.scenes.visibility import MIN_LENGTH
from frontend.evaluation.clip import Truth
from frontend.frame import Frame

_NOISE = 2.5  # grey levels, as the renderer's camera has


@dataclass(frozen=True)
class Occluder:
    """A textured bunch of discs that crosses the image once every `period` frames, from the left and right in turns.

    Its outline is round everywhere, so that it brings no straight line of its own. Made for images of about 640x480.

    Attributes:
        period: frames between two crossings' beginnings.
        speed: px per frame.
        radius: of a disc, px; the bunch is 4.2 radii wide and 6.8 radii high.
        seed: chooses the discs and their texture.
    """

    period: int = 40
    speed: float = 24.0
    radius: float = 62.0
    seed: int = 0

    def discs(self, i: int, width: int, height: int) -> NDArray[np.float64]:
        """(D, 2) centres of the discs in frame `i` of images of width x height px."""
        crossing, t = divmod(i, self.period)
        rng = np.random.default_rng([self.seed, crossing])
        grid = np.stack(np.meshgrid((-1.1, 0.0, 1.1), (-2.4, -1.2, 0.0, 1.2, 2.4)), axis=-1).reshape(-1, 2)
        bunch = self.radius * (grid + rng.uniform(-0.12, 0.12, grid.shape))
        travelled = self.speed * t - 2.2 * self.radius
        x = travelled if crossing % 2 == 0 else width - 1 - travelled
        y = height * rng.uniform(0.4, 0.6)
        return np.asarray(bunch + (x, y))

    def hides(self, points: NDArray[np.float32], i: int, size: tuple[int, int]) -> NDArray[np.bool_]:
        """(...) mask of the points (..., 2), px, behind it in frame `i` of images of `size` = (width, height)."""
        offset = points[..., None, :] - self.discs(i, *size)
        return np.asarray((np.square(offset).sum(axis=-1) < self.radius**2).any(axis=-1))

    def cover(self, frame: Frame, truth: Truth) -> tuple[Frame, Truth]:
        """The frame with the occluder drawn into it, and the lines that stay visible."""
        height, width = frame.image.shape[:2]
        discs = self.discs(frame.index, width, height)
        image = self._draw(frame, discs)
        pieces, rows = cut_by_discs(truth.segments_px, discs, self.radius)
        return replace(frame, image=image), Truth(pieces, truth.ids[rows])

    def _draw(self, frame: Frame, discs: NDArray[np.float64]) -> NDArray[np.uint8]:
        height, width = frame.image.shape[:2]
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        nearest = np.full((height, width), np.inf, np.float32)
        for cx, cy in discs.astype(np.float32):
            np.minimum(nearest, (x - cx) ** 2 + (y - cy) ** 2, out=nearest)
        alpha = np.clip(self.radius + 0.5 - np.sqrt(nearest), 0, 1).astype(np.float32)
        # The texture moves with the discs by fractions of a pixel, too.
        (left, top), texture = discs.mean(axis=0).astype(np.float32), _clouds(self.seed)
        own_x, own_y = np.broadcast_arrays((x - left) % len(texture), (y - top) % len(texture))
        coat = cv2.remap(texture, own_x.copy(), own_y.copy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        rng = np.random.default_rng([self.seed, frame.index, 1])
        coat = coat + _NOISE * rng.standard_normal(coat.shape, np.float32)
        mixed = frame.image + alpha[..., None] * (coat - frame.image)
        covered: NDArray[np.uint8] = np.clip(np.round(mixed), 0, 255).astype(np.uint8)
        return covered


@lru_cache(maxsize=2)
def _clouds(seed: int) -> NDArray[np.float32]:
    """(256, 256, 3) float32 seamless BGR pattern without lines."""
    noise = np.random.default_rng([seed, 2]).standard_normal((256, 256, 2)).astype(np.float32)
    clouds = np.zeros_like(noise)
    for sigma in (9.0, 20.0):
        blurred = cv2.GaussianBlur(np.tile(noise, (3, 3, 1)), (0, 0), sigma)[256:512, 256:512]
        clouds += blurred / blurred.std()
    brown, tint = np.array([60, 95, 125], np.float32), np.array([-6, 2, 6], np.float32)
    return np.asarray(brown * (1 + 0.09 * clouds[..., :1]) + tint * clouds[..., 1:], np.float32)


def cut_by_discs(
    segments: NDArray[np.float32], centres: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """The parts of segments outside of discs.

    Args:
        segments: (N, 2, 2) px.
        centres: (D, 2) px.
        radius: of every disc, px.

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

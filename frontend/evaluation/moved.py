"""Photographs moved by smooth homographies: real texture, exact motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.detector import AirLine
from airline.errors import InputError
from airline.evaluation.metrics import warp
from airline.image import to_gray, to_uint8
from airline.scenes.visibility import MIN_LENGTH
from frontend.evaluation.icl import FRAMES_PER_SECOND
from frontend.evaluation.truth import Clip, Truth
from frontend.frame import Frame
from frontend.sources.listing import list_images
from frontend.sources.stills import read_image
from frontend.tracking.extents import visible_parts

_VIEW = 0.75  # size of the clip's images over that of the photograph
_ZOOM = 1.1  # pixels of the view per pixel of the photograph, in the mean
_SMALLEST = 160  # px; a smaller photograph leaves no room to move in


@dataclass(frozen=True)
class MovedPhoto:
    """A photograph seen by a moving camera. Lines are those that AirLine finds in the sharp photograph."""

    name: str
    photo: NDArray[np.uint8]  # (H, W)
    frames: int  # at 30 frames per second
    seed: int  # of the motion, the light and the noise

    def __len__(self) -> int:
        return self.frames

    def __iter__(self) -> Iterator[tuple[Frame, Truth]]:
        lines = airline()(self.photo).segments
        for i, homography in enumerate(smooth_homographies(self.photo.shape[::-1], self.size, self.frames, self.seed)):
            truth = moved_lines(lines, homography, self.size)
            yield Frame(i, round(i * 1_000_000_000 / FRAMES_PER_SECOND), self._image(homography, i)), truth

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the frames, px."""
        height, width = self.photo.shape
        return round(_VIEW * width), round(_VIEW * height)

    def _image(self, homography: NDArray[np.float64], i: int) -> NDArray[np.uint8]:
        """The photograph through the homography, with blur, gamma and noise that change slowly."""
        seconds = i / FRAMES_PER_SECOND
        phase = np.random.default_rng([self.seed, 1]).uniform(0, 2 * np.pi, 2)
        sigma = 0.55 + 0.25 * np.sin(2 * np.pi * 0.9 * seconds + phase[0])
        gamma = 2 ** (0.4 * np.sin(2 * np.pi * 0.7 * seconds + phase[1]))
        seen = cv2.warpPerspective(self.photo, homography, self.size, flags=cv2.INTER_CUBIC)
        blurred = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), sigma)
        noise = np.random.default_rng([self.seed, 2, i]).standard_normal(seen.shape, np.float32)
        bright = 255 * (blurred / 255) ** np.float32(gamma) + 2.5 * noise
        return np.asarray(np.clip(np.round(bright), 0, 255), np.uint8)


def moved_photos(folder: Path, count: int = 6, frames: int = 40) -> list[Clip]:
    """Clips of `count` photographs spread evenly over a folder, named after the folder and numbered from 1.

    Raises:
        InputError: there is no such folder, no image in it, or a chosen one is damaged or too small.
    """
    paths = [row.path for row in list_images(folder, FRAMES_PER_SECOND).rows]
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(count, len(paths))).round().astype(int))
    label = folder.resolve().name
    return [MovedPhoto(f"{label}-{k + 1}", _read(paths[row]), frames, k) for k, row in enumerate(chosen)]


def smooth_homographies(photo: tuple[int, int], view: tuple[int, int], frames: int, seed: int) -> NDArray[np.float64]:
    """The image motion of a hand-held camera before a plane: pan, rotation, zoom and perspective, each two slow waves.

    Args:
        photo: (width, height), px.
        view: likewise, smaller.

    Returns:
        (F, 3, 3) float64 view_from_photo, scaled so that no corner of a view leaves the photograph.
    """
    right, bottom = view[0] - 1, view[1] - 1
    corners = np.array([[0, 0], [right, 0], [0, bottom], [right, bottom]], np.float64)
    rng = np.random.default_rng([seed, 0])
    t = np.arange(frames)[:, None]
    period, phase = rng.uniform((35, 11), (60, 17), (6, 2)), rng.uniform(0, 2 * np.pi, (6, 2))
    waves = np.sin(2 * np.pi * t[..., None] / period + phase) @ (0.8, 0.2)  # pan x, y; roll; zoom; tilt about y, x
    waves *= (0.09 * photo[0], 0.09 * photo[1], 0.06, 0.05, 0.05 / view[0], 0.05 / view[1])
    while True:
        moves = np.stack([_homography(photo, view, wave) for wave in waves])
        seen = np.stack([warp(corners, np.linalg.inv(move)) for move in moves])
        if (seen >= 0).all() and (seen <= np.array(photo) - 1).all():
            return moves
        waves *= 0.95


def _homography(photo: tuple[int, int], view: tuple[int, int], wave: NDArray[np.float64]) -> NDArray[np.float64]:
    pan_x, pan_y, roll, zoom, tilt_y, tilt_x = wave
    c, s = _ZOOM * np.exp(zoom) * np.array((np.cos(roll), np.sin(roll)))
    to_centre = np.array([[1, 0, -(photo[0] - 1) / 2 - pan_x], [0, 1, -(photo[1] - 1) / 2 - pan_y], [0, 0, 1]])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    tilt = np.array([[1, 0, 0], [0, 1, 0], [tilt_y, tilt_x, 1]])
    to_corner = np.array([[1, 0, (view[0] - 1) / 2], [0, 1, (view[1] - 1) / 2], [0, 0, 1]])
    return np.asarray(to_corner @ tilt @ turn @ to_centre)


def moved_lines(lines: NDArray[np.float32], homography: NDArray[np.float64], size: tuple[int, int]) -> Truth:
    """What a view of `size` (width, height), px, shows of the photograph's lines (N, 2, 2), if it is long enough.

    Ids are rows of `lines`.
    """
    segments = warp(lines.astype(np.float64), homography)
    low, high, lengths = visible_parts(segments, size)
    kept = np.flatnonzero(lengths >= MIN_LENGTH)
    start, delta = segments[kept, :1], np.diff(segments[kept], axis=1)
    ends = np.stack([low, high], axis=1)[kept, :, None]
    return Truth((start + ends * delta).astype(np.float32), kept.astype(np.int64))


def _read(path: Path) -> NDArray[np.uint8]:
    image = read_image(path)
    if min(image.shape[:2]) < _SMALLEST:
        size = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError(f"'{path}' has {size} px: a photograph to move needs at least {_SMALLEST}x{_SMALLEST}")
    return to_uint8(to_gray(image))


@cache
def airline() -> AirLine:
    """The default detector."""
    return AirLine()

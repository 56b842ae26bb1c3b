"""Pictures of tracks over time: what was observed, what was fused, and the line in space that fits all of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from airline.image import to_gray, to_uint8
from frontend.evaluation.consistency import image_fits
from frontend.evaluation.observations import Observations
from frontend.evaluation.posed import Posed
from frontend.evaluation.space import distances
from frontend.frame import Frame

CELLS = 8  # moments of a track's life
CELL = 216  # px
ZOOM = 3.0  # of lines that fit; longer ones are drawn smaller
LEFT = 400  # px, of the words beside the cells
GAP = 4
SHIFT = 4  # fractional bits of OpenCV's sub-pixel coordinates
GREEN, ORANGE, MAGENTA, WHITE = (80, 255, 80), (0, 165, 255), (255, 0, 255), (255, 255, 255)
RED, GREY = (60, 60, 255), (150, 150, 150)

Picture = NDArray[np.uint8]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Strip:
    """A track and how well one line in space fits it.

    Attributes:
        rows: the track's observations, in time order.
        image_lines: (N, 3) the reprojected line in each frame: a x + b y + c = 0 with unit normal (a, b), px.
        errors: (N,) distance of the farther end point to it, px.
    """

    rows: Observations
    image_lines: Array
    errors: Array


def fitted(observations: Observations, clip: Posed, least: int = 8) -> list[Strip]:
    """The tracks seen in `least` frames and more, by what was observed; the worst first."""
    observations = observations.take(observations.seen_in(least))
    lines = image_fits(observations, observations.observed_px, clip)
    errors = distances(observations.observed_px, lines).max(axis=1)
    tracks = [slice(low, high) for low, high in pairwise(observations.starts)]
    strips = [Strip(observations.take(rows), lines[rows], errors[rows]) for rows in tracks]
    return sorted(strips, key=lambda strip: -float(strip.errors.max()))


def draw_strips(frames: Iterable[Frame], strips: Sequence[Strip], cells: int = CELLS) -> Picture:
    """A row of image crops for each track, BGR.

    The crops follow the observed line at evenly spaced moments, its worst among them (framed in red). Green is the
    observed line, orange where it was measured and not detected, magenta the fused one, dashed the line in space.

    Args:
        frames: the clip, from its first frame; `Observations.frames` counts them.
        strips: the tracks.
        cells: moments of each track, at least 2.
    """
    moments = [_moments(strip, cells) for strip in strips]
    picture = np.full((len(strips) * (CELL + GAP), LEFT + cells * (CELL + GAP), 3), 30, np.uint8)
    for number, frame in enumerate(frames):
        gray = None
        for k, (strip, rows) in enumerate(zip(strips, moments, strict=True)):
            for place, row in enumerate(rows):
                if strip.rows.frames[row] != number:
                    continue
                gray = to_uint8(to_gray(frame.image)) if gray is None else gray
                top, left = k * (CELL + GAP), LEFT + place * (CELL + GAP) + GAP
                picture[top : top + CELL, left : left + CELL] = _cell(gray, strip, row)
                if row == int(strip.errors.argmax()):
                    cv2.rectangle(picture, (left, top), (left + CELL - 1, top + CELL - 1), RED, 2)
                    picture[top : top + CELL, :LEFT] = _card(strip)
    return picture


def write_strips(path: Path, picture: Picture) -> None:
    """Write the picture; InputError where that cannot be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        written = cv2.imwrite(str(path), picture)
    except (OSError, cv2.error):
        written = False
    if not written:
        raise InputError(f"cannot write '{path}': give a .png file in a folder you may write to")


def _moments(strip: Strip, cells: int) -> list[int]:
    """Rows of the track, ascending: evenly spaced, with the worst in place of the one nearest to it."""
    count = len(strip.rows)
    if count <= cells:
        return list(range(count))
    chosen = np.rint(np.linspace(0, count - 1, cells)).astype(int)
    worst = int(strip.errors.argmax())
    chosen[np.abs(chosen - worst).argmin()] = worst
    return [int(row) for row in chosen]


def _zoom(strip: Strip) -> float:
    """The same for all frames of a track."""
    delta = strip.rows.observed_px[:, 1] - strip.rows.observed_px[:, 0]
    return float(min(ZOOM, 0.85 * CELL / np.abs(delta).max()))


def _cell(gray: Picture, strip: Strip, row: int) -> Picture:
    zoom, observed = _zoom(strip), strip.rows.observed_px[row]
    to_cell = np.hstack([zoom * np.eye(2), (CELL - 1) / 2 - zoom * observed.mean(axis=0)[:, None]])
    crop = cv2.warpAffine(gray, to_cell, (CELL, CELL), flags=cv2.INTER_CUBIC, borderValue=0)
    low, high = np.percentile(crop, (1, 99))
    stretched = np.clip((crop - low) * (170 / max(high - low, 40)) + 40, 0, 255).astype(np.uint8)
    cell: Picture = np.repeat(stretched[..., None], 3, axis=2)

    a, b, c = strip.image_lines[row]
    middle = observed.mean(axis=0)
    foot = middle - (middle @ (a, b) + c) * np.array([a, b])
    steps = np.arange(-CELL, CELL, 12.0)[:, None] / zoom
    along = np.array([-b, a])
    _draw(cell, to_cell, np.stack([foot + steps * along, foot + (steps + 5 / zoom) * along], axis=1), WHITE)
    _draw(cell, to_cell, strip.rows.segments_px[row][None], MAGENTA, ticks=7)
    _draw(cell, to_cell, observed[None], ORANGE if strip.rows.measured[row] else GREEN, ticks=4)
    _write(cell, f"{strip.rows.frames[row]}", (4, 18), WHITE)
    _write(cell, f"{strip.errors[row]:.1f} px", (4, CELL - 8), RED if strip.errors[row] > 2 else WHITE)
    return cell


def _card(strip: Strip) -> Picture:
    """What is said of the track beside its cells."""
    card = np.full((CELL, LEFT, 3), 30, np.uint8)
    rows, delta = strip.rows, strip.rows.observed_px[:, 1] - strip.rows.observed_px[:, 0]
    words = (
        f"track {rows.ids[0]}: {len(rows)} frames, {rows.measured.sum()} measured",
        f"{rows.frames[0]} to {rows.frames[-1]}, {np.hypot(*delta.T).mean():.0f} px long, zoom {_zoom(strip):.1f}",
        f"worst {strip.errors.max():.1f} px in {rows.frames[strip.errors.argmax()]}",
        f"median {np.median(strip.errors):.1f} px",
    )
    for k, text in enumerate(words):
        _write(card, text, (4, 20 + 20 * k), WHITE)
    return card


def _draw(canvas: Picture, to_canvas: Array, segments: Array, colour: tuple[int, int, int], ticks: int = 0) -> None:
    """Segments (N, 2, 2) of the image, with `ticks` px to both sides at their ends."""
    points = segments @ to_canvas[:, :2].T + to_canvas[:, 2]
    if ticks:
        delta = points[:, 1] - points[:, 0]
        across = ticks * (delta[:, ::-1] * (-1, 1) / np.maximum(np.hypot(*delta.T), 1e-9)[:, None])[:, None]
        ends = np.stack([points - across, points + across], axis=2).reshape(-1, 2, 2)
        points = np.concatenate([points, ends])
    fixed = np.rint(np.clip(points, -1e4, 1e4) * (1 << SHIFT)).astype(np.int32)
    cv2.polylines(canvas, list(fixed), False, colour, 1, cv2.LINE_AA, SHIFT)


def _write(canvas: Picture, text: str, place: tuple[int, int], colour: tuple[int, int, int]) -> None:
    font = (cv2.FONT_HERSHEY_SIMPLEX, 0.55, 1)
    (width, height), below = cv2.getTextSize(text, font[0], font[1], font[2])
    x, y = place
    cv2.rectangle(canvas, (x - 2, y - height - 2), (x + width + 2, y + below), (30, 30, 30), cv2.FILLED)
    cv2.putText(canvas, text, place, font[0], font[1], colour, font[2], cv2.LINE_AA)

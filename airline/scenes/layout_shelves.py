"""A library: one long wall of equal bookcases and a railing before part of it.

Everything repeats, so that a tracker must know a line by more than its place and its looks.
"""

from __future__ import annotations

import numpy as np

from airline.scenes.furniture import cabinet, filled_case, paint_finish, poster, wood_finish
from airline.scenes.layout_indoor import lit_ceiling, room_light, tiled_floor
from airline.scenes.materials import Material, colour, finish
from airline.scenes.openings import wall
from airline.scenes.primitives import Frame, Scene, SceneBuilder, Walk

_MARGIN = 0.25  # m between the end walls and the first and the last bookcase


def shelves_scene(rng: np.random.Generator) -> Scene:
    """The camera walks along the bookcases, looks at them, and looks through the railing."""
    length, width, height = rng.uniform(14, 20), rng.uniform(4.4, 5.0), rng.uniform(2.6, 3.1)
    b = SceneBuilder()
    tiled_floor(b, length, width, rng)
    lit_ceiling(b, length, width, height, rng)
    paint = finish(rng, "plaster", colour(rng, (0.45, 0.7), (0.02, 0.25)), 1.6, 0.08)
    # Seen from inside, x runs to the left along each wall and y points into the room.
    shelves = Frame((0, 0, 0), (1, 0, 0), (0, 1, 0))
    opposite = Frame((length, width, 0), (-1, 0, 0), (0, -1, 0))
    ends = (Frame((length, 0, 0), (0, 1, 0), (-1, 0, 0)), Frame((0, width, 0), (0, -1, 0), (1, 0, 0)))
    for frame, span in ((shelves, length), (opposite, length), *((end, width) for end in ends)):
        wall(b, frame, (0, span, 0, height), [], paint)
    for end in ends:
        poster(b, end.moved((width / 2 - 0.75, 0, 0)), 1.5, height, rng)
    cabinet(b, opposite.moved((length / 2 - 1, 0, 0)), 2.0, height, rng)
    _bookcases(b, shelves.moved((_MARGIN, 0, 0)), length - 2 * _MARGIN, height, rng)
    span = rng.uniform(0.35, 0.6) * length
    _railing(b, shelves.moved((rng.uniform(0.2, 0.8) * (length - span), 1.15, 0)), span, rng)
    eye = rng.uniform(1.4, 1.6)
    walk = Walk((length / 2, rng.uniform(2.7, 3.0), eye), (length / 2 - 2.5, 0.25, 0.06), -np.pi / 2, 0.45)
    return b.build(room_light(rng, length, width), walk, np.ones((2, 3), np.float32))


def _bookcases(b: SceneBuilder, f: Frame, span: float, height: float, rng: np.random.Generator) -> None:
    """Bookcases of one size and finish from end to end; the books differ."""
    count = round(span / rng.uniform(0.8, 1.1))
    pitch = span / count
    size = (pitch, rng.uniform(0.26, 0.34), min(height - 0.3, rng.uniform(2.0, 2.4)))
    finishes, boards = (wood_finish(rng), paint_finish(rng, 0.05, 0.3)), int(rng.integers(6, 8))
    for k in range(count):
        filled_case(b, f.moved((k * pitch, 0, 0)), size, finishes, boards, rng)


def _railing(b: SceneBuilder, f: Frame, span: float, rng: np.random.Generator) -> None:
    """Balusters at equal distance between a bottom and a hand rail."""
    metal: Material = paint_finish(rng, 0.6, 0.85) if rng.random() < 0.5 else paint_finish(rng, 0.02, 0.07)
    thick, top = rng.uniform(0.018, 0.028), rng.uniform(0.95, 1.1)
    count = round(span / rng.uniform(0.11, 0.15))
    for x in np.linspace(0, span - thick, count + 1):
        b.box(f, (x, 0, 0.1), (x + thick, thick, top - 0.04), metal, "xXY")
    for low, high in ((0.07, 0.1), (top - 0.04, top)):
        b.box(f, (0, -0.01, low), (span, thick + 0.01, high), metal, "xXYzZ")
    for x in (0.0, span / 2, span - 0.04):
        b.box(f, (x, -0.01, 0), (x + 0.04, thick + 0.012, top), metal, "xXY")

"""Rooms, corridors and libraries."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from airline.scenes.builder import Light, Material, Place, Rng, Scene, SceneBuilder, Walk, colour, finish
from airline.scenes.furniture import ITEMS, cabinet, filled_case, paint_finish, poster, wood_finish
from airline.scenes.openings import Span, WindowStyle, door, wall, window

_MARGIN = 0.25  # m between the ends of a long wall and its furniture
_CLEARANCE = 1.15  # m that furniture may take from a wall, so that the camera's space stays free


@dataclass(frozen=True)
class _Fittings:
    """What the walls of a room share; not every room has panels."""

    skirting: Material
    panel: Material | None
    windows: WindowStyle


def indoor_scene(rng: Rng) -> Scene:
    """A furnished room or corridor; the camera walks in its free middle."""
    corridor = rng.random() < 0.4
    sides = ((10, 18), (3.0, 3.8)) if corridor else ((6, 9), (5, 7.5))
    length, width, height = (rng.uniform(*side) for side in (*sides, (2.5, 3.3)))
    world = Place(SceneBuilder())
    _tiled_floor(world, length, width, rng)
    _lit_ceiling(world, length, width, height, rng)
    paint = colour(rng, (0.35, 0.7), (0.02, 0.3))
    texture = str(rng.choice(["plaster", "plaster", "brick", "stone", "patches"]))
    contrast = {"plaster": 0.08, "brick": 0.2, "stone": 0.2, "patches": 0.08}[texture]
    skirting = finish(rng, "wood", colour(rng, (0.05, 0.2) if rng.random() < 0.5 else (0.8, 0.9), (0, 0.3)), 0.8, 0.1)
    panel = finish(rng, "wood", colour(rng, (0.15, 0.6), (0.1, 0.6)), 0.8, 0.15) if rng.random() < 0.7 else None
    fittings = _Fittings(skirting, panel, _window_style(rng))
    for place, span in _walls(world, length, width):
        tone = rng.uniform(0.8, 1.15)
        tile = rng.uniform(0.7, 1.1) if texture == "brick" else rng.uniform(1.2, 2.2)
        material = finish(rng, texture, paint * tone, tile, contrast)
        # Furniture fills the corners along the long walls; the short walls leave room for it.
        _furnished_wall(place, span, _MARGIN if span == length else _CLEARANCE, height, material, fittings, rng)
    reach_x = length / 2 - (2.2 if corridor else 2.0)
    reach_y = max(0.15, width / 2 - (1.45 if corridor else 1.9))
    heading = 0.0 if corridor else rng.uniform(0, 2 * np.pi)
    centre = (length / 2, width / 2, rng.uniform(1.35, 1.65))
    walk = Walk(centre, (reach_x, reach_y, 0.08), heading, 0.55 if corridor else 1.2)
    return world.scene.build(_room_light(length, width, rng), walk)


def shelves_scene(rng: Rng) -> Scene:
    """A library: the camera walks along a wall of equal bookcases and looks at them, partly through a railing.

    Everything repeats, so that a tracker must know a line by more than its place and its looks.
    """
    length, width, height = rng.uniform(14, 20), rng.uniform(4.4, 5.0), rng.uniform(2.6, 3.1)
    world = Place(SceneBuilder())
    _tiled_floor(world, length, width, rng)
    _lit_ceiling(world, length, width, height, rng)
    paint = finish(rng, "plaster", colour(rng, (0.45, 0.7), (0.02, 0.25)), 1.6, 0.08)
    walls = _walls(world, length, width)
    for place, span in (walls[0], walls[2], walls[1], walls[3]):
        wall(place, span, height, [], paint)
    (shelves, _), (opposite, _) = walls[0], walls[2]
    for end, _ in (walls[1], walls[3]):
        poster(end.moved((width / 2 - 0.75, 0, 0)), 1.5, height, rng)
    cabinet(opposite.moved((length / 2 - 1, 0, 0)), 2.0, height, rng)
    _bookcases(shelves.moved((_MARGIN, 0, 0)), length - 2 * _MARGIN, height, rng)
    span = rng.uniform(0.35, 0.6) * length
    _railing(shelves.moved((rng.uniform(0.2, 0.8) * (length - span), 1.15, 0)), span, rng)
    eye = rng.uniform(1.4, 1.6)
    walk = Walk((length / 2, rng.uniform(2.7, 3.0), eye), (length / 2 - 2.5, 0.25, 0.06), -np.pi / 2, 0.45)
    return world.scene.build(_room_light(length, width, rng), walk)


def _walls(world: Place, length: float, width: float) -> list[tuple[Place, float]]:
    """The four walls and their lengths; seen from inside, x runs to the left and y points into the room."""
    return [
        (world.facing((0, 0, 0), (1, 0, 0)), length),
        (world.facing((length, 0, 0), (0, 1, 0)), width),
        (world.facing((length, width, 0), (-1, 0, 0)), length),
        (world.facing((0, width, 0), (0, -1, 0)), width),
    ]


def _room_light(length: float, width: float, rng: Rng) -> Light:
    """Soft light from a random side, with a fall-off across the room."""
    turn, ambient = rng.uniform(0, 2 * np.pi), rng.uniform(0.65, 0.8)
    direction = np.array([0.7 * np.cos(turn), 0.7 * np.sin(turn), 0.3])
    direction /= np.linalg.norm(direction)
    gradient = rng.uniform(-0.2, 0.2, 3) / np.array([length, width, 5.0])
    return Light(direction, ambient, 1.1 - ambient, gradient)


def _tiled_floor(world: Place, length: float, width: float, rng: Rng) -> None:
    """A floor of tiles, planks or carpet on the ground from (0, 0) to (length, width)."""
    kind = rng.choice(["tiles", "planks", "plain"], p=[0.5, 0.38, 0.12])
    base = colour(rng, (0.2, 0.5), (0.1, 0.5))
    if kind == "plain":
        carpet = finish(rng, str(rng.choice(["fabric", "speckle", "marble"])), base, 1.0, 0.25)
        world.quad((0, 0, 0), (length, 0, 0), (0, width, 0), carpet, "")
        return
    if kind == "tiles":
        nx, ny = max(1, round(length / rng.uniform(0.5, 0.9))), max(1, round(width / rng.uniform(0.5, 0.9)))
    else:
        nx, ny = 1, round(width / rng.uniform(0.18, 0.3))
    name = str(rng.choice(["marble", "speckle", "plaster"] if kind == "tiles" else ["wood"]))
    dark, light = 0.72 * rng.uniform(0.6, 1), rng.uniform(1.1, 1.4)
    for i, j in product(range(nx), range(ny)):
        tone = (dark, light)[(i + j) % 2] * rng.uniform(0.9, 1.1)
        tile, corner = finish(rng, name, base * tone, 0.9, 0.12), (length * i / nx, width * j / ny, 0)
        world.quad(corner, (length / nx, 0, 0), (0, width / ny, 0), tile, shift=tuple(rng.random(2)))


def _lit_ceiling(world: Place, length: float, width: float, height: float, rng: Rng) -> None:
    """A ceiling over (0, 0) to (length, width) with lamps, and by chance panels, beams and pipes."""
    white = finish(rng, "plaster", (0.7, 0.72, 0.75), 1.5, 0.05)
    if rng.random() < 0.5:
        nx, ny = round(length / 0.9), round(width / 0.9)
        for i, j in product(range(nx), range(ny)):
            tone = (0.55, 0.75)[(i + j) % 2]
            panel = finish(rng, "speckle", (tone, tone, tone), 0.8, 0.06)
            world.quad((length * i / nx, width * j / ny, height), (0, width / ny, 0), (length / nx, 0, 0), panel)
    else:
        world.quad((0, 0, height), (0, width, 0), (length, 0, 0), white, "")
    lamp = Material(white.texture, (1.0, 1.0, 0.98), (1.0, 1.0, 1.0), 1.0)
    rim = finish(rng, "plaster", (0.25, 0.25, 0.25), 1.0, 0.05)
    count = max(2, round(length / rng.uniform(2.0, 3.5)))
    for k in range(count):
        x, w, deep = length * (k + 0.5) / count, rng.uniform(0.15, 0.3), rng.uniform(0.5, 0.8)
        low, high = width / 2 - deep, width / 2 + deep
        world.box((x - w, low, height - 0.07), (x + w, high, height), rim, "xXyYz")
        world.quad((x - w + 0.04, low + 0.04, height - 0.074), (0, 2 * deep - 0.08, 0), (2 * w - 0.08, 0, 0), lamp)
    if rng.random() < 0.5:
        beam = finish(rng, "wood", colour(rng, (0.1, 0.4), (0.2, 0.6)), 1.0, 0.2)
        for k in range(1, count):
            x = length * k / count
            world.box((x - 0.08, 0, height - 0.22), (x + 0.08, width, height), beam, "xXz")
    if rng.random() < 0.5:
        for k in range(int(rng.integers(1, 4))):
            radius, y = rng.uniform(0.03, 0.07), 0.3 + 0.25 * k
            metal = finish(rng, "plaster", colour(rng, (0.2, 0.7), (0, 0.6)), 0.7, 0.06)
            world.pipe((0, y, height - 0.35), (length, y, height - 0.35), radius, metal)


def _window_style(rng: Rng) -> WindowStyle:
    glass = finish(rng, "marble", colour(rng, (0.85, 1.0), (0.0, 0.2)), 2.0, 0.1)
    name, value = ("wood", (0.05, 0.2)) if rng.random() < 0.5 else ("plaster", (0.45, 0.6))
    frame = finish(rng, name, colour(rng, value, (0, 0.4)), 0.8, 0.1)
    columns, rows = int(rng.integers(2, 4)), int(rng.integers(1, 4))
    return WindowStyle(glass, frame, columns, rows, rng.uniform(0.035, 0.06), 0.16, 0.08)


def _furnished_wall(
    at: Place, span: float, margin: float, height: float, material: Material, fittings: _Fittings, rng: Rng
) -> None:
    """One wall: slots from left to right, each with a door, a window or an item of furniture."""
    items, weights = [*ITEMS], np.array([*ITEMS.values()])
    holes: list[Span] = []
    doors: list[Span] = []
    x, end = margin, span - margin
    if end - x < 1.3:
        x, end = span / 2 - 0.75, span / 2 + 0.75
    while end - x > 1.0:
        width = min(rng.uniform(1.0, 2.4), end - x)
        kind = rng.random() if span - 2 * margin >= 1.3 else 0.3 * rng.random()
        if kind < 0.22:
            hole = (x + 0.15, x + 0.15 + min(rng.uniform(0.85, 1.1), width - 0.3), 0.0, rng.uniform(1.98, 2.15))
            doors.append(hole)
            holes.append(hole)
        elif kind < 0.42:
            sill = rng.uniform(0.8, 1.1)
            hole = (x + 0.15, x + width - 0.15, sill, min(height - 0.25, sill + rng.uniform(1.0, 1.5)))
            window(at, hole, fittings.windows, material)
            holes.append(hole)
        else:
            item = items[rng.choice(len(items), p=weights / weights.sum())]
            item(at.moved((x, 0, 0)), width - 0.1, height, rng)
        x += width + rng.uniform(0.05, 0.3)
    for hole in doors:
        door(at, hole, rng, material)
    wall(at, span, height, holes, material)
    starts, ends = [0.0, *(d[1] + 0.12 for d in doors)], [*(d[0] - 0.12 for d in doors), span]
    for start, stop in zip(starts, ends, strict=True):
        if stop - start > 0.05:
            at.box((start, 0, 0), (stop, 0.018, 0.09), fittings.skirting, "xXYZ")
            if fittings.panel is not None:
                _panels(at, start, stop, fittings.panel, fittings.skirting)


def _panels(at: Place, start: float, stop: float, panel: Material, rail: Material) -> None:
    """Panelling up to the height of a chair's back."""
    count = max(1, round((stop - start) / 0.55))
    pitch = (stop - start) / count
    for k in range(count):
        x = start + k * pitch
        at.box((x + 0.04, 0, 0.15), (x + pitch - 0.04, 0.015, 0.62), panel, "xXYzZ")
    at.box((start, 0, 0.68), (stop, 0.025, 0.74), rail, "xXYzZ")


def _bookcases(at: Place, span: float, height: float, rng: Rng) -> None:
    """Bookcases of one size and finish from end to end; the books differ."""
    count = round(span / rng.uniform(0.8, 1.1))
    pitch = span / count
    size = (pitch, rng.uniform(0.26, 0.34), min(height - 0.3, rng.uniform(2.0, 2.4)))
    wood, back, boards = wood_finish(rng), paint_finish(rng, 0.05, 0.3), int(rng.integers(6, 8))
    for k in range(count):
        filled_case(at.moved((k * pitch, 0, 0)), size, wood, back, boards, rng)


def _railing(at: Place, span: float, rng: Rng) -> None:
    """Balusters at equal distance between a bottom and a hand rail."""
    metal = paint_finish(rng, 0.6, 0.85) if rng.random() < 0.5 else paint_finish(rng, 0.02, 0.07)
    thick, top = rng.uniform(0.018, 0.028), rng.uniform(0.95, 1.1)
    count = round(span / rng.uniform(0.11, 0.15))
    for x in np.linspace(0, span - thick, count + 1):
        at.box((x, 0, 0.1), (x + thick, thick, top - 0.04), metal, "xXY")
    for low, high in ((0.07, 0.1), (top - 0.04, top)):
        at.box((0, -0.01, low), (span, thick + 0.01, high), metal, "xXYzZ")
    for x in (0.0, span / 2, span - 0.04):
        at.box((x, -0.01, 0), (x + 0.04, thick + 0.012, top), metal, "xXY")

"""Rooms and corridors."""

from __future__ import annotations

import numpy as np

from airline.scenes.furniture import ITEMS
from airline.scenes.materials import Material, colour, finish
from airline.scenes.openings import Span, WindowStyle, door, wall, window
from airline.scenes.primitives import WORLD, Frame, Light, Scene, SceneBuilder, Walk

_CLEARANCE = 1.15  # m that furniture may take from a wall, so that the camera's space stays free


def indoor_scene(rng: np.random.Generator) -> Scene:
    """A furnished room or corridor; the camera walks in its free middle."""
    corridor = rng.random() < 0.4
    if corridor:
        length, width = rng.uniform(10, 18), rng.uniform(3.0, 3.8)
    else:
        length, width = rng.uniform(6, 9), rng.uniform(5, 7.5)
    height = rng.uniform(2.5, 3.3)
    b = SceneBuilder()
    tiled_floor(b, length, width, rng)
    lit_ceiling(b, length, width, height, rng)
    paint = colour(rng, (0.35, 0.7), (0.02, 0.3))
    texture = str(rng.choice(["plaster", "plaster", "brick", "stone", "patches"]))
    contrast = {"plaster": 0.08, "brick": 0.2, "stone": 0.2, "patches": 0.08}[texture]
    skirting = finish(rng, "wood", colour(rng, (0.05, 0.2) if rng.random() < 0.5 else (0.8, 0.9), (0, 0.3)), 0.8, 0.1)
    panel = finish(rng, "wood", colour(rng, (0.15, 0.6), (0.1, 0.6)), 0.8, 0.15) if rng.random() < 0.7 else None
    style = _window_style(rng)
    # Seen from inside, x runs to the left along each wall and y points into the room.
    walls = (
        (Frame((0, 0, 0), (1, 0, 0), (0, 1, 0)), length),
        (Frame((length, 0, 0), (0, 1, 0), (-1, 0, 0)), width),
        (Frame((length, width, 0), (-1, 0, 0), (0, -1, 0)), length),
        (Frame((0, width, 0), (0, -1, 0), (1, 0, 0)), width),
    )
    for frame, span in walls:
        tone = rng.uniform(0.8, 1.15)
        tile = rng.uniform(0.7, 1.1) if texture == "brick" else rng.uniform(1.2, 2.2)
        material = finish(rng, texture, (paint[0] * tone, paint[1] * tone, paint[2] * tone), tile, contrast)
        # Furniture fills the corners along the long walls; the short walls leave room for it.
        margin = 0.25 if span == length else _CLEARANCE
        _wall(b, frame, span, margin, height, material, skirting, style, panel, rng)
    reach_x = length / 2 - (2.2 if corridor else 2.0)
    reach_y = max(0.15, width / 2 - (1.45 if corridor else 1.9))
    heading = 0.0 if corridor else rng.uniform(0, 2 * np.pi)
    eye = rng.uniform(1.35, 1.65)
    walk = Walk((length / 2, width / 2, eye), (reach_x, reach_y, 0.08), heading, 0.55 if corridor else 1.2)
    return b.build(room_light(rng, length, width), walk, np.ones((2, 3), np.float32))


def room_light(rng: np.random.Generator, length: float, width: float) -> Light:
    """Soft light from a random side, with a fall-off across the room."""
    turn, ambient = rng.uniform(0, 2 * np.pi), rng.uniform(0.65, 0.8)
    direction = np.array([0.7 * np.cos(turn), 0.7 * np.sin(turn), 0.3])
    direction /= np.linalg.norm(direction)
    gradient = rng.uniform(-0.2, 0.2, 3) / np.array([length, width, 5.0])
    return Light(direction, ambient, 1.1 - ambient, gradient)


def tiled_floor(b: SceneBuilder, length: float, width: float, rng: np.random.Generator) -> None:
    """A floor of tiles, planks or carpet on the ground from (0, 0) to (length, width)."""
    kind = rng.choice(["tiles", "planks", "plain"], p=[0.5, 0.38, 0.12])
    base = colour(rng, (0.2, 0.5), (0.1, 0.5))
    if kind == "plain":
        carpet = finish(rng, str(rng.choice(["fabric", "speckle", "marble"])), base, 1.0, 0.25)
        b.quad(WORLD, (0, 0, 0), (length, 0, 0), (0, width, 0), carpet, "")
        return
    if kind == "tiles":
        nx, ny = max(1, round(length / rng.uniform(0.5, 0.9))), max(1, round(width / rng.uniform(0.5, 0.9)))
        names = ["marble", "speckle", "plaster"]
    else:
        nx, ny = 1, round(width / rng.uniform(0.18, 0.3))
        names = ["wood"]
    name = str(rng.choice(names))
    dark, light = 0.72 * rng.uniform(0.6, 1), rng.uniform(1.1, 1.4)
    for i in range(nx):
        for j in range(ny):
            tone = (dark, light)[(i + j) % 2] * rng.uniform(0.9, 1.1)
            tile = finish(rng, name, (base[0] * tone, base[1] * tone, base[2] * tone), 0.9, 0.12)
            x, y = length * i / nx, width * j / ny
            b.quad(WORLD, (x, y, 0), (length / nx, 0, 0), (0, width / ny, 0), tile, shift=tuple(rng.random(2)))


def lit_ceiling(b: SceneBuilder, length: float, width: float, height: float, rng: np.random.Generator) -> None:
    """A ceiling over (0, 0) to (length, width) with lamps, and by chance panels, beams and pipes."""
    white = finish(rng, "plaster", (0.7, 0.72, 0.75), 1.5, 0.05)
    if rng.random() < 0.5:
        nx, ny = round(length / 0.9), round(width / 0.9)
        for i in range(nx):
            for j in range(ny):
                tone = (0.55, 0.75)[(i + j) % 2]
                panel = finish(rng, "speckle", (tone, tone, tone), 0.8, 0.06)
                x, y = length * i / nx, width * j / ny
                b.quad(WORLD, (x, y, height), (0, width / ny, 0), (length / nx, 0, 0), panel)
    else:
        b.quad(WORLD, (0, 0, height), (0, width, 0), (length, 0, 0), white, "")
    lamp = Material(white.texture, (1.0, 1.0, 0.98), (1.0, 1.0, 1.0), 1.0)
    rim = finish(rng, "plaster", (0.25, 0.25, 0.25), 1.0, 0.05)
    count = max(2, round(length / rng.uniform(2.0, 3.5)))
    for k in range(count):
        x, w, deep = length * (k + 0.5) / count, rng.uniform(0.15, 0.3), rng.uniform(0.5, 0.8)
        low, high = width / 2 - deep, width / 2 + deep
        b.box(WORLD, (x - w, low, height - 0.07), (x + w, high, height), rim, "xXyYz")
        b.quad(WORLD, (x - w + 0.04, low + 0.04, height - 0.074), (0, 2 * deep - 0.08, 0), (2 * w - 0.08, 0, 0), lamp)
    if rng.random() < 0.5:
        beam = finish(rng, "wood", colour(rng, (0.1, 0.4), (0.2, 0.6)), 1.0, 0.2)
        for k in range(1, count):
            x = length * k / count
            b.box(WORLD, (x - 0.08, 0, height - 0.22), (x + 0.08, width, height), beam, "xXz")
    if rng.random() < 0.5:
        for k in range(int(rng.integers(1, 4))):
            radius = rng.uniform(0.03, 0.07)
            y = 0.3 + 0.25 * k
            metal = finish(rng, "plaster", colour(rng, (0.2, 0.7), (0, 0.6)), 0.7, 0.06)
            b.pipe(WORLD, (0, y, height - 0.35), (length, y, height - 0.35), radius, metal)


def _window_style(rng: np.random.Generator) -> WindowStyle:
    glass = finish(rng, "marble", colour(rng, (0.85, 1.0), (0.0, 0.2)), 2.0, 0.1)
    dark = rng.random() < 0.5
    frame = finish(
        rng, "wood" if dark else "plaster", colour(rng, (0.05, 0.2) if dark else (0.45, 0.6), (0, 0.4)), 0.8, 0.1
    )
    return WindowStyle(
        glass, frame, int(rng.integers(2, 4)), int(rng.integers(1, 4)), rng.uniform(0.035, 0.06), 0.16, 0.08
    )


def _wall(
    b: SceneBuilder,
    frame: Frame,
    span: float,
    margin: float,
    height: float,
    material: Material,
    skirting: Material,
    style: WindowStyle,
    panel: Material | None,
    rng: np.random.Generator,
) -> None:
    """One wall: slots from left to right, each with a door, a window or an item of furniture."""
    holes: list[Span] = []
    doors: list[Span] = []
    weights = np.array([weight for _, weight in ITEMS])
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
            window(b, frame, hole, style, material)
            holes.append(hole)
        else:
            item = ITEMS[rng.choice(len(ITEMS), p=weights / weights.sum())][0]
            item(b, frame.moved((x, 0, 0)), width - 0.1, height, rng)
        x += width + rng.uniform(0.05, 0.3)
    for hole in doors:
        door(b, frame, hole, rng, material)
    wall(b, frame, (0, span, 0, height), holes, material)
    starts, ends = [0.0, *(d[1] + 0.12 for d in doors)], [*(d[0] - 0.12 for d in doors), span]
    for start, stop in zip(starts, ends, strict=True):
        if stop - start > 0.05:
            b.box(frame, (start, 0, 0), (stop, 0.018, 0.09), skirting, "xXYZ")
            if panel is not None:
                _panels(b, frame, start, stop, panel, skirting)


def _panels(b: SceneBuilder, frame: Frame, start: float, stop: float, panel: Material, rail: Material) -> None:
    """Panelling up to the height of a chair's back."""
    count = max(1, round((stop - start) / 0.55))
    pitch = (stop - start) / count
    for k in range(count):
        x = start + k * pitch
        b.box(frame, (x + 0.04, 0, 0.15), (x + pitch - 0.04, 0.015, 0.62), panel, "xXYzZ")
    b.box(frame, (start, 0, 0.68), (stop, 0.025, 0.74), rail, "xXYzZ")

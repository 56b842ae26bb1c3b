"""Streets between two rows of houses."""

from __future__ import annotations

import numpy as np

from airline.scenes.builder import Light, Material, Place, Rng, Scene, SceneBuilder, Walk, colour, finish
from airline.scenes.openings import Span, WindowStyle, door, wall, window

_HALF = 26.0  # m from the middle of the street to the houses that close it


def street_scene(rng: Rng) -> Scene:
    """A street along x with pavements, furniture and houses on both sides and at both ends."""
    world = Place(SceneBuilder())
    road, pavement = rng.uniform(3.0, 4.2), rng.uniform(2.0, 3.2)
    edge = road + pavement
    _ground(world, road, edge, rng)
    for side in (-1.0, 1.0):
        # Seen from the street, x runs to the left along a facade and y towards the viewer.
        _row(world.facing((side * _HALF, side * edge, 0), (-side, 0, 0)), 2 * _HALF, rng)
        _street_furniture(world.facing((side * _HALF, side * road, 0), (-side, 0, 0)), pavement, rng)
    for side in (-1.0, 1.0):
        _row(world.facing((side * _HALF, -side * (edge + 1), 0), (0, side, 0)), 2 * edge + 2, rng)
    turn, ambient = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 0.65)
    sun = np.array([np.cos(turn), np.sin(turn), 1.1]) / np.hypot(1, 1.1)
    light = Light(sun, ambient, 1.15 - ambient, np.array([*rng.uniform(-0.004, 0.004, 2), 0.01]))
    heading = rng.choice([0.0, np.pi]) + rng.uniform(-0.35, 0.35)
    walk = Walk((0.0, rng.uniform(-0.3, 0.3), rng.uniform(1.5, 1.9)), (15.0, 0.25 * road, 0.1), heading, 0.5)
    blue = rng.uniform(0.6, 0.95)
    sky = np.array([[0.95, 0.93, 0.9], [blue, 0.75 * blue, 0.55 * blue]], np.float32)
    return world.scene.build(light, walk, sky)


def _ground(world: Place, road: float, edge: float, rng: Rng) -> None:
    asphalt = finish(rng, "asphalt", colour(rng, (0.1, 0.2), (0, 0.1)), 1.3, 0.3)
    world.quad((-_HALF, -road, 0), (2 * _HALF, 0, 0), (0, 2 * road, 0), asphalt, "")
    paint = finish(rng, "patches", (0.7, 0.72, 0.75), 0.7, 0.15)
    for x in np.arange(-_HALF + 2, _HALF - 2, 4.0):
        world.quad((x, -0.07, 0.004), (1.8, 0, 0), (0, 0.14, 0), paint)
    if rng.random() < 0.6:
        start = rng.uniform(-10, 10)
        for y in np.arange(-road + 0.3, road - 0.5, 0.9):
            world.quad((start, y, 0.006), (2.6, 0, 0), (0, 0.45, 0), paint)
    stone = finish(rng, "speckle", colour(rng, (0.45, 0.6), (0, 0.1)), 0.9, 0.15)
    base = colour(rng, (0.25, 0.4), (0, 0.25))
    count = round(2 * _HALF / rng.uniform(0.9, 1.6))
    for side in (-1.0, 1.0):
        low, high = (road, road + 0.18) if side > 0 else (-road - 0.18, -road)
        world.box((-_HALF, low, 0), (_HALF, high, 0.13), stone, "YyZ")
        y0, y1 = (road + 0.18, edge + 1) if side > 0 else (-edge - 1, -road - 0.18)
        for k in range(count):
            tone = (0.78, 1.2)[k % 2] * rng.uniform(0.92, 1.08)
            slabs = finish(rng, "speckle", base * tone, 0.9, 0.12)
            x = -_HALF + 2 * _HALF * k / count
            world.quad((x, y0, 0.12), (2 * _HALF / count, 0, 0), (0, y1 - y0, 0), slabs, "lr")


def _row(at: Place, span: float, rng: Rng) -> None:
    """Houses shoulder to shoulder, each a little further back or forward."""
    x = 0.0
    while span - x > 1.0:
        width = rng.uniform(6.0, 11.0)
        if span - x - width < 4.0:
            width = span - x
        _house(at.moved((x, -rng.uniform(0.0, 0.5), 0)), width, rng)
        x += width


def _house(at: Place, width: float, rng: Rng) -> None:
    """A facade with rows of windows, a door, bands and a cornice, and a metre of its flanks."""
    floors, storey = int(rng.integers(2, 5)), rng.uniform(2.9, 3.7)
    height = floors * storey + rng.uniform(0.3, 1.0)
    name = str(rng.choice(["plaster", "brick", "stone", "patches"]))
    contrast = {"plaster": 0.08, "brick": 0.25, "stone": 0.2, "patches": 0.08}[name]
    face = finish(rng, name, colour(rng, (0.25, 0.75), (0.05, 0.5)), rng.uniform(1.4, 2.4), contrast)
    bright = max(face.high) > 0.5
    trim = finish(rng, "plaster", colour(rng, (0.08, 0.25) if bright else (0.7, 0.9), (0, 0.3)), 0.8, 0.06)
    pale = max(face.high) < 0.6 or rng.random() < 0.2
    frame = finish(rng, "plaster", colour(rng, (0.75, 0.95) if pale else (0.06, 0.2), (0, 0.2)), 0.6, 0.05)
    glass = finish(rng, "patches", colour(rng, (0.05, 0.16) if pale else (0.35, 0.6), (0.1, 0.4)), 1.5, 0.3)
    columns, rows = int(rng.integers(1, 3)), int(rng.integers(1, 3))
    bar, depth, casing = rng.uniform(0.06, 0.1), rng.uniform(0.1, 0.25), rng.choice([0.0, 0.12])
    style = WindowStyle(glass, frame, columns, rows, bar, depth, casing)
    columns = max(2, round(width / rng.uniform(2.2, 3.3)))
    pitch = width / columns
    w, h = pitch * rng.uniform(0.42, 0.6), storey * rng.uniform(0.42, 0.6)
    door_column, balconies = int(rng.integers(columns)), rng.random() < 0.3
    holes: list[Span] = []
    for floor in range(floors):
        for column in range(columns):
            x, z = (column + 0.5) * pitch, floor * storey + 0.95
            if floor == 0 and column == door_column:
                hole = (x - 0.55, x + 0.55, 0.3, 2.6)
                door(at, hole, rng, face)
                _steps(at.moved((x, 0, 0.12)), rng)
            else:
                hole = (x - w / 2, x + w / 2, z, z + h)
                window(at, hole, style, face)
                if balconies and floor > 0 and (column + floor) % 2:
                    _balcony(at.moved((x, 0, z - 0.15)), w, trim)
            holes.append(hole)
    wall(at, width, height, holes, face, "tlr")
    at.quad((0, 0, 0), (0, -1, 0), (0, 0, height), face, "l")
    at.quad((width, -1, 0), (0, 1, 0), (0, 0, height), face, "r")
    at.box((-0.02, 0, height - 0.3), (width + 0.02, 0.3, height), trim)
    if rng.random() < 0.6:
        for floor in range(1, floors):
            at.box((0, 0, floor * storey + 0.2), (width, 0.08, floor * storey + 0.4), trim, "xXYzZ")
    door_at = (door_column + 0.5) * pitch
    for start, end in ((0.0, door_at - 0.7), (door_at + 0.7, width)):
        if end - start > 0.2:
            at.box((start, 0, 0.12), (end, 0.05, 0.5), trim, "xXYZ")
    if rng.random() < 0.7:
        at.pipe((width - 0.15, 0.1, 0.12), (width - 0.15, 0.1, height - 0.3), 0.06, trim)


def _steps(at: Place, rng: Rng) -> None:
    stone = finish(rng, "speckle", colour(rng, (0.4, 0.7), (0, 0.15)), 0.8, 0.12)
    for k in range(2):
        at.box((-0.8, 0, 0), (0.8, 0.6 - 0.3 * k, 0.09 * (k + 1)), stone, "xXYZ")


def _balcony(at: Place, width: float, trim: Material) -> None:
    half, deep = width / 2 + 0.2, 0.7
    at.box((-half, 0, -0.12), (half, deep, 0), trim)
    at.box((-half, deep - 0.06, 0.85), (half, deep - 0.01, 0.92), trim)
    for x in np.linspace(-half, half - 0.04, max(4, round(width / 0.22))):
        at.box((x, deep - 0.05, 0), (x + 0.03, deep - 0.02, 0.85), trim, "xXyY")


def _street_furniture(at: Place, pavement: float, rng: Rng) -> None:
    """Lamp posts, railings, crates and parked cars along a kerb (y towards the road)."""
    metal = finish(rng, "plaster", colour(rng, (0.03, 0.15), (0, 0.4)), 0.7, 0.1)
    x = rng.uniform(1, 4)
    while x < 2 * _HALF - 4:
        kind = rng.random()
        spot = at.moved((x, -0.45, 0.12))
        if kind < 0.3:
            spot.pipe((0, 0, 0), (0, 0, 4.6), 0.06, metal)
            spot.box((-0.12, -0.1, 4.6), (0.12, 0.9, 4.75), metal)
            x += rng.uniform(3, 6)
        elif kind < 0.55:
            count = int(rng.integers(4, 9))
            _railing(spot, count, metal)
            x += 0.5 * count + rng.uniform(1, 4)
        elif kind < 0.75:
            for _ in range(int(rng.integers(1, 4))):
                crate = finish(rng, "wood", colour(rng, (0.2, 0.6), (0.2, 0.7)), 0.8, 0.2)
                size = rng.uniform(0.4, 0.8)
                turned = at.moved((x, -pavement * rng.uniform(0.3, 0.6), 0.12), rng.uniform(-0.5, 0.5))
                turned.box((-size / 2, -size / 2, 0), (size / 2, size / 2, size), crate, "xXyYZ")
                x += 0.9
            x += rng.uniform(0.5, 3)
        else:
            _car(at.moved((x, 0.15, 0)), rng)
            x += rng.uniform(5.5, 9)


def _railing(at: Place, count: int, metal: Material) -> None:
    length = 0.5 * count
    for k in range(count + 1):
        at.box((0.5 * k, -0.03, 0), (0.5 * k + 0.05, 0.02, 1.0), metal, "xXyYZ")
    for z in (0.35, 0.95):
        at.box((0.05, -0.02, z), (length, 0.01, z + 0.05), metal, "yYzZ")


def _car(at: Place, rng: Rng) -> None:
    """A parked van of boxes, 1.2 m wide so that the road's middle stays free."""
    paint = finish(rng, "plaster", colour(rng, (0.1, 0.8), (0.1, 0.85)), 1.5, 0.03)
    dark = finish(rng, "plaster", (0.03, 0.03, 0.03), 1.0, 0.2)
    lamp = finish(rng, "plaster", colour(rng, (0.7, 0.95), (0.0, 0.6)), 0.5, 0.1)
    length, tall = rng.uniform(3.4, 4.6), rng.uniform(0.45, 0.75)
    at.box((0, 0, 0.35), (length, 1.2, 0.95), paint)
    at.box((0.25 * length, 0.08, 0.95), (0.9 * length, 1.12, 0.95 + tall), paint, "xXyYZ")
    at.box((0.08 * length, 0.1, 0.12), (0.92 * length, 1.1, 0.35), dark, "xXyY")
    for x, wide in ((0.25 * length - 0.004, 1), (0.9 * length + 0.004, -1)):
        y = 0.6 + 0.45 * wide
        at.quad((x, y, 1.0), (0, -0.9 * wide, 0), (0, 0, tall - 0.12), dark)
    for x, wide in ((-0.004, 1), (length + 0.004, -1)):
        for y in (0.05, 0.9):
            at.quad((x, y + (0.25 if wide > 0 else 0), 0.6), (0, -0.25 * wide, 0), (0, 0, 0.15), lamp)
        at.quad((x, 0.6 + 0.2 * wide, 0.5), (0, -0.4 * wide, 0), (0, 0, 0.1), lamp)
    for k in range(3):
        x = (0.28 + 0.21 * k) * length
        at.quad((x + 0.18 * length, 1.124, 1.0), (-0.18 * length, 0, 0), (0, 0, tall - 0.12), dark)
        at.quad((x, 0.076, 1.0), (0.18 * length, 0, 0), (0, 0, tall - 0.12), dark)

"""Things that stand or hang at the wall of a room.

Each function fills a slot of its wall: x from 0 to `width`, y out of the wall, z up from the floor.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from airline.scenes.builder import Material, Place, Rng, Vec, colour, finish


def wood_finish(rng: Rng) -> Material:
    tone = rng.uniform(0.12, 0.6)
    brown = (tone * rng.uniform(0.3, 0.6), tone * rng.uniform(0.6, 0.75), tone)
    return finish(rng, "wood", brown, rng.uniform(0.5, 1.2), 0.18)


def paint_finish(rng: Rng, low: float = 0.08, high: float = 0.8) -> Material:
    return finish(rng, "plaster", colour(rng, (low, high), (0.0, 0.6)), 0.7, 0.06)


def bookcase(at: Place, width: float, height: float, rng: Rng) -> None:
    """Shelves full of books, the repeated structure that trackers confuse."""
    depth, top = rng.uniform(0.26, 0.36), min(height - 0.15, rng.uniform(1.5, 2.3))
    filled_case(at, (width, depth, top), wood_finish(rng), paint_finish(rng, 0.05, 0.3), int(rng.integers(4, 7)), rng)


def filled_case(at: Place, size: Vec, wood: Material, back: Material, boards: int, rng: Rng) -> None:
    """A bookcase of a given width, depth and height, materials and number of boards; books by chance."""
    (width, depth, top), thick = size, 0.03
    at.box((0, 0, 0), (thick, depth, top), wood, "xXYZ")
    at.box((width - thick, 0, 0), (width, depth, top), wood, "xXYZ")
    at.quad((width - thick, 0.01, 0), (2 * thick - width, 0, 0), (0, 0, top), back, "")
    levels = np.linspace(0.06, top - thick, boards)
    for z in levels:
        at.box((thick, 0, z), (width - thick, depth - 0.01, z + thick), wood, "YzZ")
    for z, above in zip(levels[:-1] + thick, levels[1:], strict=True):
        _books(at.moved((thick, 0.02, z)), width - 2 * thick, depth, above - z, rng)


def _books(at: Place, width: float, depth: float, height: float, rng: Rng) -> None:
    x = rng.uniform(0, 0.1)
    while x < width - 0.09:
        if rng.random() < 0.1:
            x += rng.uniform(0.05, 0.25)
            continue
        book = rng.uniform(0.035, 0.09)
        tall, deep = rng.uniform(0.6, 0.95) * height, rng.uniform(0.6, 0.9) * depth
        cover = finish(rng, "fabric", colour(rng, (0.04, 0.85), (0.1, 0.85)), 0.4, 0.12)
        at.box((x, 0, 0), (x + book, deep, tall), cover, "xXYZ")
        if rng.random() < 0.3:
            label = finish(rng, "blobs", colour(rng, (0.6, 0.95), (0, 0.2)), 0.3, 0.3)
            at.quad((x + book * 0.85, deep + 0.003, 0.6 * tall), (-0.7 * book, 0, 0), (0, 0, 0.2 * tall), label)
        x += book + 0.001


def hanging_shelves(at: Place, width: float, height: float, rng: Rng) -> None:
    """One or two boards with books high on the wall."""
    wood, z = wood_finish(rng), 1.45
    while z + 0.6 < height:
        at.box((0, 0, z), (width, 0.25, z + 0.03), wood, "xXYzZ")
        for x in (0.15 * width, 0.85 * width):
            at.box((x, 0, z - 0.15), (x + 0.03, 0.2, z), wood, "xXYz")
        _books(at.moved((0.02, 0.01, z + 0.03)), width - 0.04, 0.24, 0.3, rng)
        z += rng.uniform(0.45, 1.2)


def poster(at: Place, width: float, height: float, rng: Rng) -> None:
    """One to three framed pictures with blobs and patches."""
    count = int(rng.integers(1, 4)) if width > 1.2 else 1
    each = width / count
    for k in range(count):
        w, h = each * rng.uniform(0.5, 0.85), rng.uniform(0.4, min(0.9, height - 1.5))
        x, z = k * each + (each - w) / 2, rng.uniform(1.15, height - h - 0.3)
        bar = rng.uniform(0.02, 0.06)
        at.box((x, 0, z), (x + w, 0.025, z + h), paint_finish(rng, 0.03, 0.9))
        first, second = colour(rng, (0.03, 0.3), (0.2, 0.9)), colour(rng, (0.5, 0.95), (0.1, 0.8))
        picture = finish(rng, str(rng.choice(["blobs", "patches"])), first, rng.uniform(0.5, 1.1))
        picture, mount = replace(picture, low=first, high=second), paint_finish(rng, 0.75, 0.95)
        for y, rim, material in ((0.029, bar, mount), (0.033, bar + 0.06, picture)):
            at.quad((x + w - rim, y, z + rim), (2 * rim - w, 0, 0), (0, 0, h - 2 * rim), material)


def cabinet(at: Place, width: float, height: float, rng: Rng) -> None:
    """A chest with drawers or doors and handles."""
    depth, top = rng.uniform(0.4, 0.6), min(height - 0.2, rng.choice([0.8, 1.1, 1.9]))
    body, front = wood_finish(rng), wood_finish(rng)
    handle = paint_finish(rng, 0.02, 0.12) if max(front.high) > 0.35 else paint_finish(rng, 0.7, 0.9)
    at.box((0, 0, 0), (width, depth, top), body, "xXYZ")
    columns, rows = max(1, round(width / rng.uniform(0.4, 0.7))), int(rng.integers(1, 5))
    w, h = width / columns, (top - 0.1) / rows
    for i in range(columns):
        for j in range(rows):
            x, z = i * w, 0.08 + j * h
            at.box((x + 0.015, depth, z + 0.015), (x + w - 0.015, depth + 0.018, z + h - 0.015), front, "xXYzZ")
            low = (x + w / 2 - 0.07, depth + 0.018, z + h - 0.09)
            at.box(low, (x + w / 2 + 0.07, depth + 0.04, z + h - 0.07), handle, "xXYzZ")
    _clutter(at.moved((0, 0, top)), width, depth, rng)
    if top < 1.0:
        (hanging_shelves if rng.random() < 0.4 else poster)(at, width, height, rng)


def _clutter(at: Place, width: float, depth: float, rng: Rng) -> None:
    """A few small boxes on a top."""
    x = 0.1
    while x < width - 0.35:
        size = rng.uniform((0.1, 0.08, 0.08), (0.3, min(0.3, depth - 0.1), 0.35))
        turned = at.moved((x + size[0] / 2, depth / 2, 0), rng.uniform(-0.3, 0.3))
        name = str(rng.choice(["plaster", "patches", "fabric"]))
        box = finish(rng, name, colour(rng, (0.1, 0.9), (0.1, 0.7)), 0.5, 0.12)
        turned.box((-size[0] / 2, -size[1] / 2, 0), (size[0] / 2, size[1] / 2, size[2]), box, "xXyYZ")
        x += size[0] + rng.uniform(0.1, 0.5)


def desk(at: Place, width: float, height: float, rng: Rng) -> None:
    """A table with legs, a screen and clutter."""
    depth, top, thick = rng.uniform(0.6, 0.8), rng.uniform(0.7, 0.78), 0.035
    wood, legs = wood_finish(rng), paint_finish(rng, 0.05, 0.7)
    at.box((0, 0.02, top - thick), (width, depth, top), wood)
    for x in (0.04, width - 0.09):
        for y in (0.05, depth - 0.09):
            at.box((x, y, 0), (x + 0.05, y + 0.05, top - thick), legs, "xXyY")
    frame, screen = paint_finish(rng, 0.02, 0.08), finish(rng, "blobs", colour(rng, (0.4, 0.8), (0.1, 0.6)), 0.5, 0.5)
    w, x = min(0.6, 0.5 * width), rng.uniform(0.1, 0.4 * width)
    at.box((x, 0.15, top + 0.1), (x + w, 0.18, top + 0.1 + 0.6 * w), frame)
    at.quad((x + w - 0.02, 0.184, top + 0.12), (0.04 - w, 0, 0), (0, 0, 0.6 * w - 0.04), screen)
    at.box((x + w / 2 - 0.03, 0.12, top), (x + w / 2 + 0.03, 0.15, top + 0.2), frame)
    _clutter(at.moved((x + w, 0.05, top)), width - x - w, depth - 0.1, rng)
    (hanging_shelves if rng.random() < 0.5 else poster)(at, width, height, rng)


def cartons(at: Place, width: float, height: float, rng: Rng) -> None:
    """Stacks of boxes, each a little turned, with a stripe of tape."""
    x = 0.0
    while x < width - 0.35:
        w, z = min(rng.uniform(0.35, 0.6), width - x), 0.0
        for _ in range(int(rng.integers(1, 4))):
            h, scale = rng.uniform(0.22, 0.45), rng.uniform(0.75, 0.95)
            half = scale * w / 2
            turned = at.moved((x + w / 2, 0.42, z), rng.uniform(-0.15, 0.15))
            tone = rng.uniform(0.25, 0.6)
            card = finish(rng, "fabric", (0.45 * tone, 0.7 * tone, tone), 0.6, 0.1)
            turned.box((-half, -half, 0), (half, half, h), card, "xXyYZ")
            tape = finish(rng, "plaster", (0.6 * tone + 0.3, 0.7 * tone + 0.3, min(1.0, 0.8 * tone + 0.35)), 0.5, 0.05)
            turned.quad((0.06 * w, half + 0.003, 0), (-0.12 * w, 0, 0), (0, 0, h), tape, "lr")
            z += h
        x += w + 0.05
    hanging_shelves(at.moved((0, 0, 0.2)), width, height - 0.2, rng)


def radiator(at: Place, width: float, height: float, rng: Rng) -> None:
    """A ribbed heater with its two pipes."""
    body, dark = paint_finish(rng, 0.6, 0.85), paint_finish(rng, 0.1, 0.3)
    w = min(width - 0.25, rng.uniform(0.8, 1.4))
    at.box((0, 0.03, 0.14), (w, 0.06, 0.72), dark, "xXYzZ")
    rib = rng.uniform(0.06, 0.1)
    for k in range(int(w / rib)):
        at.box((k * rib, 0.06, 0.12), (k * rib + 0.65 * rib, 0.14, 0.74), body, "xXYzZ")
    for x in (w + 0.08, w + 0.18):
        at.pipe((x, 0.07, 0), (x, 0.07, height), rng.uniform(0.014, 0.025), body)
    poster(at, w, height, rng)


def pipes(at: Place, width: float, height: float, rng: Rng) -> None:
    """Risers of several sizes from the floor to the ceiling."""
    x = 0.1
    while x < width - 0.1:
        radius = rng.uniform(0.025, 0.09)
        foot = at.moved((x + radius, radius + 0.03, 0))
        foot.pipe((0, 0, 0), (0, 0, height), radius, paint_finish(rng, 0.1, 0.8))
        x += 2 * radius + rng.uniform(0.05, 0.3)


def stairs(at: Place, width: float, height: float, rng: Rng) -> None:
    """A flight of steps along the wall, with a rail."""
    rise, run, deep = rng.uniform(0.16, 0.19), rng.uniform(0.25, 0.3), rng.uniform(0.7, 0.9)
    tread, riser = wood_finish(rng), paint_finish(rng, 0.5, 0.85)
    count = min(int(width / run), int((height - 1.0) / rise))
    for k in range(count):
        x = k * run
        at.box((x, 0, 0), (x + run, deep, (k + 1) * rise - 0.04), riser, "xY" if k < count - 1 else "xXY")
        at.box((x - 0.02, 0, (k + 1) * rise - 0.04), (x + run, deep + 0.02, (k + 1) * rise), tread, "xYzZ")
    rail = paint_finish(rng, 0.03, 0.15)
    for k in range(count):
        x, z = (k + 0.5) * run, (k + 1) * rise
        at.box((x, deep - 0.06, z), (x + 0.025, deep - 0.035, z + 0.8), rail, "xXyY")
    slope = (run * (count - 1), 0.0, rise * (count - 1))
    x, z = 0.5 * run, rise + 0.8
    at.quad((x + slope[0], deep - 0.02, z + slope[2]), (-slope[0], 0, -slope[2]), (0, 0, 0.06), rail)
    at.quad((x, deep - 0.08, z), slope, (0, 0, 0.06), rail)
    at.quad((x, deep - 0.02, z + 0.06), (0, -0.06, 0), slope, rail)


def lockers(at: Place, width: float, height: float, rng: Rng) -> None:
    """A row of narrow metal doors with slots."""
    top, depth = min(1.9, height - 0.3), 0.45
    first, second = paint_finish(rng, 0.15, 0.4), paint_finish(rng, 0.5, 0.75)
    dark = paint_finish(rng, 0.02, 0.06)
    count = max(2, round(width / 0.38))
    w = width / count
    for k in range(count):
        at.box((k * w, 0, 0.08), ((k + 1) * w - 0.012, depth, top), (first, second)[k % 2], "xXYzZ")
        for j in range(4):
            corner = ((k + 0.8) * w, depth + 0.003, top - 0.2 - 0.06 * j)
            at.quad(corner, (-0.6 * w, 0, 0), (0, 0, 0.022), dark)
        at.box((k * w + 0.04, depth, 0.95), (k * w + 0.07, depth + 0.03, 1.12), dark, "xXYzZ")


def board(at: Place, width: float, height: float, rng: Rng) -> None:
    """A white or black board with notes on it."""
    rim = paint_finish(rng, 0.2, 0.4)
    white = rng.random() < 0.5
    face = finish(rng, "marble", (0.85, 0.85, 0.85) if white else (0.04, 0.06, 0.04), 1.5, 0.08)
    at.box((0, 0, 0.85), (width, 0.03, 1.95), rim, "xXYzZ")
    at.quad((width - 0.04, 0.033, 0.89), (0.08 - width, 0, 0), (0, 0, 1.02), face)
    for _ in range(int(rng.integers(3, 9))):
        w, h = rng.uniform(0.12, 0.3, 2)
        x, z = rng.uniform(0.1 + w, width - 0.1), rng.uniform(0.95, 1.88 - h)
        note = finish(rng, "blobs", colour(rng, (0.25, 0.5) if white else (0.6, 0.9), (0.2, 0.9)), 0.3, 0.35)
        at.quad((x, 0.036 + 0.003 * rng.random(), z), (-w, 0, 0), (0, 0, h), note)


# how often each is chosen, relative to the others
ITEMS = {
    bookcase: 4.5, poster: 1.5, hanging_shelves: 1.0, cabinet: 2.0, desk: 2.0, cartons: 1.0,
    radiator: 1.0, pipes: 0.7, stairs: 0.7, lockers: 1.0, board: 1.0,
}  # fmt: skip

"""Walls with holes, and the doors and windows that fill them: shared by rooms and facades.

A wall is the plane y = 0 of its place: x runs along it, y out of it towards the viewer, z up.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from airline.scenes.builder import Material, Place, Rng, colour, finish

Span = tuple[float, float, float, float]  # x0, x1, z0, z1


def wall(at: Place, width: float, height: float, holes: list[Span], material: Material, edges: str = "btlr") -> None:
    """A wall with rectangular holes, cut into strips that wear one continuous texture."""
    levels = sorted({0, height, *(z for hole in holes for z in hole[2:] if 0 < z < height)})
    for low, high in pairwise(levels):
        cuts = sorted(hole[:2] for hole in holes if hole[2] < high and hole[3] > low)
        starts, ends = [0, *(cut[1] for cut in cuts)], [*(cut[0] for cut in cuts), width]
        for start, end in zip(starts, ends, strict=True):
            if end - start > 1e-6 and high - low > 1e-6:
                at.quad((end, 0, low), (start - end, 0, 0), (0, 0, high - low), material, "", (width - end, low))
    a, b, c, d = (0, 0, 0), (width, 0, 0), (0, 0, height), (width, 0, height)
    sides = {"b": (a, b), "t": (c, d), "l": (a, c), "r": (b, d)}
    for name in edges:
        at.line(*sides[name])


def reveal(at: Place, hole: Span, depth: float, material: Material) -> None:
    """The four inner sides of a hole `depth` metres deep."""
    x0, x1, z0, z1 = hole
    at.quad((x0, -depth, z0), (0, depth, 0), (0, 0, z1 - z0), material)
    at.quad((x1, -depth, z0), (0, 0, z1 - z0), (0, depth, 0), material)
    at.quad((x0, -depth, z0), (x1 - x0, 0, 0), (0, depth, 0), material)
    at.quad((x0, -depth, z1), (0, depth, 0), (x1 - x0, 0, 0), material)


def casing(at: Place, hole: Span, width: float, material: Material, sill: bool) -> None:
    """A flat frame around a hole, on the wall; with `sill` also below it."""
    x0, x1, z0, z1 = hole
    thick, foot = 0.03, z0 - width if sill else z0
    at.box((x0 - width, 0, foot), (x0, thick, z1 + width), material, "xXYzZ")
    at.box((x1, 0, foot), (x1 + width, thick, z1 + width), material, "xXYzZ")
    at.box((x0, 0, z1), (x1, thick, z1 + width), material, "YzZ")
    if sill:
        at.box((x0, 0, z0 - width), (x1, thick, z0), material, "YzZ")


@dataclass(frozen=True)
class WindowStyle:
    """What the windows of one wall have in common.

    Attributes:
        glass, frame: materials.
        columns, rows: panes.
        bar: width of the frame and of the bars between panes, m.
        depth: how deep the glass lies in the wall, m.
        casing: width of the frame on the wall, m; 0 for none.
    """

    glass: Material
    frame: Material
    columns: int
    rows: int
    bar: float
    depth: float
    casing: float


def window(at: Place, hole: Span, style: WindowStyle, side: Material) -> None:
    """Glass with bars in a hole of a wall whose inner sides are of material `side`."""
    x0, x1, z0, z1 = hole
    reveal(at, hole, style.depth, side)
    at.quad((x1, -style.depth, z0), (x0 - x1, 0, 0), (0, 0, z1 - z0), style.glass, "")
    back, front, bar = -style.depth, -style.depth + 0.04, style.bar
    for x in (x0, x1 - bar):
        at.box((x, back, z0), (x + bar, front, z1), style.frame, "xXY")
    for z in (z0, z1 - bar):
        at.box((x0 + bar, back, z), (x1 - bar, front, z + bar), style.frame, "YzZ")
    for x in np.linspace(x0, x1, style.columns + 1)[1:-1]:
        at.box((x - bar / 2, back, z0 + bar), (x + bar / 2, front, z1 - bar), style.frame, "xXY")
    for z in np.linspace(z0, z1, style.rows + 1)[1:-1]:
        at.box((x0 + bar, back, z - bar / 2), (x1 - bar, front - 0.005, z + bar / 2), style.frame, "YzZ")
    if style.casing > 0:
        casing(at, hole, style.casing, style.frame, sill=True)
        at.box((x0 - 0.12, 0, z0 - 0.05), (x1 + 0.12, 0.14, z0), style.frame, "xXYzZ")


def door(at: Place, hole: Span, rng: Rng, side: Material) -> None:
    """A door leaf with panels or panes, handle and casing in a hole that reaches the floor."""
    x0, x1, z0, z1 = hole
    depth = rng.uniform(0.06, 0.14)
    leaf = colour(rng, (0.15, 0.55), (0.1, 0.6))
    leaf_finish = finish(rng, str(rng.choice(["wood", "plaster"])), leaf, 0.7, 0.15)
    trim = finish(rng, "plaster", colour(rng, (0.05, 0.85), (0, 0.2)), 0.6, 0.06)
    bright = max(leaf) < 0.3
    inset_base = colour(rng, (0.5, 0.8) if bright else (0.06, 0.14), (0, 0.3))
    inset = finish(rng, "marble" if bright else "plaster", inset_base, 0.8, 0.15)
    reveal(at, hole, depth, side)
    at.quad((x1, -depth, z0), (x0 - x1, 0, 0), (0, 0, z1 - z0), leaf_finish)
    casing(at, hole, rng.uniform(0.06, 0.11), trim, sill=False)
    columns, rows = int(rng.integers(1, 3)), int(rng.integers(1, 5))
    width, height = (x1 - x0 - 0.12) / columns, (z1 - z0 - 0.2) / rows
    for i in range(columns):
        for j in range(rows):
            x, z = x0 + 0.06 + i * width, z0 + 0.12 + j * height
            corner = (x + width - 0.05, -depth + 0.004, z + 0.05)
            at.quad(corner, (0.1 - width, 0, 0), (0, 0, height - 0.1), inset)
    at.box((x0 + 0.05, -depth, z0 + 1.0), (x0 + 0.15, -depth + 0.06, z0 + 1.04), trim)

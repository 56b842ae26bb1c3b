"""Walls with holes, and the doors and windows that fill them: shared by rooms and facades.

Wall frames have x along the wall, y out of the wall towards the viewer and z up; the wall is the plane y = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from airline.scenes.materials import Material, colour, finish
from airline.scenes.primitives import Frame, SceneBuilder

Span = tuple[float, float, float, float]  # x0, x1, z0, z1


def wall(
    b: SceneBuilder, frame: Frame, outline: Span, holes: list[Span], material: Material, edges: str = "btlr"
) -> None:
    """A wall with rectangular holes, cut into strips that wear one continuous texture."""
    x0, x1, z0, z1 = outline
    levels = sorted({z0, z1, *(z for hole in holes for z in hole[2:] if z0 < z < z1)})
    for low, high in pairwise(levels):
        cuts = sorted(hole[:2] for hole in holes if hole[2] < high and hole[3] > low)
        starts = [x0, *(cut[1] for cut in cuts)]
        ends = [*(cut[0] for cut in cuts), x1]
        for start, end in zip(starts, ends, strict=True):
            if end - start > 1e-6 and high - low > 1e-6:
                b.quad(frame, (end, 0, low), (start - end, 0, 0), (0, 0, high - low), material, "", (x1 - end, low))
    sides = {
        "b": ((x0, 0, z0), (x1, 0, z0)),
        "t": ((x0, 0, z1), (x1, 0, z1)),
        "l": ((x0, 0, z0), (x0, 0, z1)),
        "r": ((x1, 0, z0), (x1, 0, z1)),
    }
    for name in edges:
        b.line(frame, *sides[name])


def reveal(b: SceneBuilder, frame: Frame, hole: Span, depth: float, material: Material) -> None:
    """The four inner sides of a hole `depth` metres deep."""
    x0, x1, z0, z1 = hole
    b.quad(frame, (x0, -depth, z0), (0, depth, 0), (0, 0, z1 - z0), material)
    b.quad(frame, (x1, -depth, z0), (0, 0, z1 - z0), (0, depth, 0), material)
    b.quad(frame, (x0, -depth, z0), (x1 - x0, 0, 0), (0, depth, 0), material)
    b.quad(frame, (x0, -depth, z1), (0, depth, 0), (x1 - x0, 0, 0), material)


def casing(
    b: SceneBuilder, frame: Frame, hole: Span, width: float, thick: float, material: Material, sill: bool
) -> None:
    """A flat frame around a hole, on the wall; with `sill` also below it."""
    x0, x1, z0, z1 = hole
    foot = z0 - width if sill else z0
    b.box(frame, (x0 - width, 0, foot), (x0, thick, z1 + width), material, "xXYzZ")
    b.box(frame, (x1, 0, foot), (x1 + width, thick, z1 + width), material, "xXYzZ")
    b.box(frame, (x0, 0, z1), (x1, thick, z1 + width), material, "YzZ")
    if sill:
        b.box(frame, (x0, 0, z0 - width), (x1, thick, z0), material, "YzZ")


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


def window(b: SceneBuilder, frame: Frame, hole: Span, style: WindowStyle, side: Material) -> None:
    """Glass with bars in a hole of a wall whose inner sides are of material `side`."""
    x0, x1, z0, z1 = hole
    reveal(b, frame, hole, style.depth, side)
    b.quad(frame, (x1, -style.depth, z0), (x0 - x1, 0, 0), (0, 0, z1 - z0), style.glass, "")
    back, front, bar = -style.depth, -style.depth + 0.04, style.bar
    for x in (x0, x1 - bar):
        b.box(frame, (x, back, z0), (x + bar, front, z1), style.frame, "xXY")
    for z in (z0, z1 - bar):
        b.box(frame, (x0 + bar, back, z), (x1 - bar, front, z + bar), style.frame, "YzZ")
    for x in np.linspace(x0, x1, style.columns + 1)[1:-1]:
        b.box(frame, (x - bar / 2, back, z0 + bar), (x + bar / 2, front, z1 - bar), style.frame, "xXY")
    for z in np.linspace(z0, z1, style.rows + 1)[1:-1]:
        b.box(frame, (x0 + bar, back, z - bar / 2), (x1 - bar, front - 0.005, z + bar / 2), style.frame, "YzZ")
    if style.casing > 0:
        casing(b, frame, hole, style.casing, 0.03, style.frame, sill=True)
        b.box(frame, (x0 - 0.12, 0, z0 - 0.05), (x1 + 0.12, 0.14, z0), style.frame, "xXYzZ")


def door(b: SceneBuilder, frame: Frame, hole: Span, rng: np.random.Generator, side: Material) -> None:
    """A door leaf with panels or panes, handle and casing in a hole that reaches the floor."""
    x0, x1, z0, z1 = hole
    depth = rng.uniform(0.06, 0.14)
    leaf = colour(rng, (0.15, 0.55), (0.1, 0.6))
    leaf_finish = finish(rng, str(rng.choice(["wood", "plaster"])), leaf, 0.7, 0.15)
    trim = finish(rng, "plaster", colour(rng, (0.05, 0.85), (0, 0.2)), 0.6, 0.06)
    bright = max(leaf) < 0.3
    inset_base = colour(rng, (0.5, 0.8) if bright else (0.06, 0.14), (0, 0.3))
    inset = finish(rng, "marble" if bright else "plaster", inset_base, 0.8, 0.15)
    reveal(b, frame, hole, depth, side)
    b.quad(frame, (x1, -depth, z0), (x0 - x1, 0, 0), (0, 0, z1 - z0), leaf_finish)
    casing(b, frame, hole, rng.uniform(0.06, 0.11), 0.03, trim, sill=False)
    columns, rows = int(rng.integers(1, 3)), int(rng.integers(1, 5))
    width, height = (x1 - x0 - 0.12) / columns, (z1 - z0 - 0.2) / rows
    for i in range(columns):
        for j in range(rows):
            x, z = x0 + 0.06 + i * width, z0 + 0.12 + j * height
            corner = (x + width - 0.05, -depth + 0.004, z + 0.05)
            b.quad(frame, corner, (0.1 - width, 0, 0), (0, 0, height - 0.1), inset)
    b.box(frame, (x0 + 0.05, -depth, z0 + 1.0), (x0 + 0.15, -depth + 0.06, z0 + 1.04), trim)

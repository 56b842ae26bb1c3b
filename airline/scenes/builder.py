"""Scenes as arrays of textured parallelograms, straight lines and pipes, and the builder that collects them.

World axes: z up, x and y on the ground, metres. A face is the parallelogram origin + a u + b v with a, b in [0, 1]; it
is seen from the side its normal u x v points to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from airline.scenes.textures import texture_index

Array = NDArray[np.float64]
Rng = np.random.Generator
Vec = Sequence[float] | Array  # of three
PIPE_SIDES = 20
TOUCHING = 1e-3  # m: closer lines are one


@dataclass(frozen=True)
class Material:
    """A texture that blends two colours.

    Attributes:
        texture: index into the texture bank.
        low, high: BGR linear albedo in [0, 1] where the texture is 0 and 1.
        tile: size of one texture tile, m.
    """

    texture: int
    low: Vec
    high: Vec
    tile: float


@dataclass(frozen=True)
class Walk:
    """The free space a camera may move in, and where it looks.

    Attributes:
        centre, reach: position = centre +- reach, m.
        yaw, sweep: looks towards yaw +- sweep, rad; yaw 0 is +x, counter-clockwise from above.
    """

    centre: Vec
    reach: Vec
    yaw: float
    sweep: float


@dataclass(frozen=True)
class Scene:
    """A world ready for rendering: F faces, L lines and C pipes.

    Attributes:
        origins, u, v: (F, 3) float64, m.
        textures: (F,) int32 texture index.
        materials: (F, 13) float32 texture coordinates (s, t) = (m0 + m1 a, m2 + m3 b) in tiles; light at the origin and
            its change along u and v; BGR albedo where the texture is 0, and its change per level of the texture.
        lines: (L, 2, 3) float64 straight edges a person would see; a line's id is its row.
        pipes: (C, 2, 3) float64 axes; radii: (C,) float64. Outline k of pipe c has the id L + 2 c + k.
        walk: the camera's free space.
        sky: (2, 3) float32 BGR light at the horizon and overhead.
    """

    origins: Array
    u: Array
    v: Array
    textures: NDArray[np.int32]
    materials: NDArray[np.float32]
    lines: Array
    pipes: Array
    radii: Array
    walk: Walk
    sky: NDArray[np.float32]


@dataclass(frozen=True)
class Light:
    """Sun or lamp light for flat shading.

    Attributes:
        direction: unit vector towards the light.
        ambient, diffuse: strengths; a face that looks at the light gets their sum.
        gradient: (3,) relative change of light per metre, everywhere alike, so that split walls stay seamless.
    """

    direction: Array
    ambient: float
    diffuse: float
    gradient: Array

    def at(self, points: Array, normals: Array) -> Array:
        """(N,) light on surfaces at `points` (N, 3) with unit `normals` (N, 3)."""
        towards = normals @ self.direction
        # Faces turned away still differ from each other, as under a real sky or bounced light.
        lambert = self.ambient * (1 + 0.35 * towards) + self.diffuse * np.maximum(towards, 0)
        return np.asarray(lambert * np.clip(1 + points @ self.gradient, 0.75, 1.25))


# The axes that span each side of a box, in the order that turns its normal outwards.
_PLANES = {"x": (2, 1), "X": (1, 2), "y": (0, 2), "Y": (2, 0), "z": (1, 0), "Z": (0, 1)}
_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True)
class Place:
    """A local coordinate system (origin, orthonormal axes) whose methods add things to the scene in its coordinates."""

    scene: SceneBuilder
    origin: Array = field(default_factory=lambda: np.zeros(3))
    x: Array = field(default_factory=lambda: _X)
    y: Array = field(default_factory=lambda: _Y)

    def point(self, p: Vec) -> Array:
        """World positions of local points (..., 3)."""
        p = np.asarray(p, np.float64)
        return np.asarray(self.origin + self.x * p[..., :1] + self.y * p[..., 1:2] + _Z * p[..., 2:])

    def moved(self, p: Vec, turn: float = 0.0) -> Place:
        """This place moved to the local point p and turned about its z axis by `turn` rad."""
        c, s = np.cos(turn), np.sin(turn)
        return Place(self.scene, self.point(p), c * self.x + s * self.y, c * self.y - s * self.x)

    def facing(self, origin: Vec, along: Vec) -> Place:
        """The place at a world point whose x axis is the horizontal unit vector `along`."""
        return Place(self.scene, np.array(origin, float), np.array(along, float), np.array((-along[1], along[0], 0.0)))

    def quad(
        self, corner: Vec, u: Vec, v: Vec, material: Material, edges: str = "btlr", shift: tuple[float, float] = (0, 0)
    ) -> None:
        """Add a parallelogram; `edges` names its sides that are lines: bottom and top along u, left and right along v.

        `shift` (m) moves the texture, so that the pieces of a split wall continue one another.
        """
        a, b, d = corners = self.point(np.asarray(corner) + ((0, 0, 0), u, v))
        self.scene.faces.append((corners, material, shift))
        c = b + d - a
        sides = {"b": (a, b), "t": (d, c), "l": (a, d), "r": (b, c)}
        self.scene.lines.extend(sides[name] for name in edges)

    def box(self, low: Vec, high: Vec, material: Material, faces: str = "xXyYzZ") -> None:
        """Add a cuboid between local corners; `faces` names its sides: "x" at the low x, "X" at the high x, ..."""
        along, place = np.diag(np.subtract(high, low)), self.point(low)
        # Equal boxes in different places must not wear equal texture.
        shift = (7.3 * place[0] + 3.1 * place[2], 5.9 * place[1] + 1.7 * place[2])
        for name in faces:
            i, j = _PLANES[name]
            corner = np.where(np.arange(3) == "XYZ".find(name), high, low)
            self.quad(corner, along[i], along[j], material, shift=shift)

    def line(self, start: Vec, end: Vec) -> None:
        """Add a straight edge."""
        self.scene.lines.append((self.point(start), self.point(end)))

    def pipe(self, start: Vec, end: Vec, radius: float, material: Material) -> None:
        """Add a cylinder without caps; its lines are the two outlines seen from the camera."""
        self.scene.pipes.append(((self.point(start), self.point(end)), radius, material))


Line = tuple[Array, Array]
Face = tuple[Array, Material, tuple[float, float]]  # (3, 3): origin, ends of u and v; material; shift


@dataclass
class SceneBuilder:
    """What places have added; of pipes the axis, radius and material."""

    faces: list[Face] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    pipes: list[tuple[Line, float, Material]] = field(default_factory=list)

    def build(self, light: Light, walk: Walk, sky: NDArray[np.float32] | None = None) -> Scene:
        """Shade the faces, merge lines that several faces share, and freeze everything."""
        flat = len(self.faces)
        faces = [*self.faces, *(face for pipe in self.pipes for face in _prism(*pipe))]
        materials = [material for _, material, _ in faces]
        a, b, d = np.stack([corners for corners, _, _ in faces], axis=1)
        u, v = b - a, d - a
        normals = np.cross(u, v)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        corner_normals = np.repeat(normals[None], 3, axis=0)
        for c, ((start, end), _, _) in enumerate(self.pipes):  # round, though drawn with flat sides
            rows = slice(flat + c * PIPE_SIDES, flat + (c + 1) * PIPE_SIDES)
            axis = (end - start) / np.linalg.norm(end - start)
            for k, points in enumerate((a, b, d)):
                outward = points[rows] - start
                outward -= np.outer(outward @ axis, axis)
                corner_normals[k, rows] = outward / np.linalg.norm(outward, axis=1, keepdims=True)
        lights = [light.at(points, corner_normals[k]) for k, points in enumerate((a, b, d))]
        tile = np.array([m.tile for m in materials])
        shift = np.array([shift for _, _, shift in faces], np.float64).reshape(-1, 2) / tile[:, None]
        along_u, along_v = np.linalg.norm(u, axis=1) / tile, np.linalg.norm(v, axis=1) / tile
        mapping = np.stack([shift[:, 0], along_u, shift[:, 1], along_v], axis=1)
        shades = np.stack([lights[0], lights[1] - lights[0], lights[2] - lights[0]], axis=1)
        low, high = np.array([m.low for m in materials]), np.array([m.high for m in materials])
        return Scene(
            origins=a,
            u=u,
            v=v,
            textures=np.array([m.texture for m in materials], np.int32),
            materials=np.concatenate([mapping, shades, low, (high - low) / 255], axis=1).astype(np.float32),
            lines=merge_collinear(np.array(self.lines)),
            pipes=np.array([axis for axis, _, _ in self.pipes]).reshape(-1, 2, 3),
            radii=np.array([radius for _, radius, _ in self.pipes]),
            walk=walk,
            sky=np.ones((2, 3), np.float32) if sky is None else sky,
        )


def colour(rng: Rng, value: tuple[float, float], saturation: tuple[float, float]) -> Array:
    """A random linear BGR colour with brightness and saturation within bounds."""
    hue, v, s = rng.uniform(0, 6), rng.uniform(*value), rng.uniform(*saturation)
    return np.asarray(v * (1 - s * np.clip(np.abs((hue + np.array([2.0, 4.0, 0.0])) % 6 - 3) - 1, 0, 1)))


def finish(rng: Rng, name: str, base: Vec, tile: float = 1.0, contrast: float = 0.25) -> Material:
    """A material whose colours lie around `base`, apart by the relative `contrast`."""
    texture, base = texture_index(name, int(rng.integers(100))), np.asarray(base)
    return Material(texture, base * (1 - contrast), np.minimum(1, base * (1 + contrast)), tile)


def _prism(ends: Line, radius: float, material: Material) -> list[Face]:
    """The flat sides of a pipe."""
    start, axis = ends[0], ends[1] - ends[0]
    side = np.cross(axis, _X if abs(axis[0]) < 0.5 * np.linalg.norm(axis) else _Y)
    side *= radius / np.linalg.norm(side)
    other = np.cross(axis, side) / np.linalg.norm(axis)
    angles = 2 * np.pi * np.arange(PIPE_SIDES + 1) / PIPE_SIDES
    ring = start + np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * other
    half = float(np.sin(np.pi / PIPE_SIDES))
    sides = enumerate(pairwise(ring))
    return [(np.stack([p, q, p + axis]), material, (k * 2 * radius * half, 0.0)) for k, (p, q) in sides]


def merge_collinear(segments: Array) -> Array:
    """(L, 2, 3) unions of those of (N, 2, 3) segments that lie on one line in space and overlap or touch, m."""
    direction = segments[:, 1] - segments[:, 0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    rounded = np.round(direction, 5)
    leading = np.take_along_axis(rounded, (rounded != 0).argmax(axis=1)[:, None], axis=1)
    direction *= np.where(leading < 0, -1.0, 1.0)
    start = np.einsum("nk,nk->n", segments[:, 0], direction)
    end = np.einsum("nk,nk->n", segments[:, 1], direction)
    foot = segments[:, 0] - start[:, None] * direction
    start, end = np.minimum(start, end), np.maximum(start, end)
    # The odd offset keeps round coordinates away from the rounding boundary.
    key = np.concatenate([np.round(direction * 2000 + 0.137), np.round(foot / TOUCHING + 0.137)], axis=1)
    weights = np.random.default_rng(0).integers(1, 2**62, 6)
    _, group = np.unique((key.astype(np.int64) * weights).sum(axis=1), return_inverse=True)
    merged: list[tuple[int, float, float]] = []
    for row in np.lexsort((start, group)):
        if merged and group[merged[-1][0]] == group[row] and start[row] <= merged[-1][2] + TOUCHING:
            first, low, high = merged[-1]
            merged[-1] = (first, low, max(high, end[row]))
        else:
            merged.append((row, start[row], end[row]))
    rows = np.array([m[0] for m in merged])
    span = np.array([m[1:] for m in merged])
    return np.asarray(foot[rows, None] + span[:, :, None] * direction[rows, None])

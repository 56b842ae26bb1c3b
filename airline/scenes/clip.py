"""A camera moving through a generated scene: images with exact lines, depth and poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.kernels.threads import map_ahead
from airline.scenes import raster, visibility
from airline.scenes.builder import Array, Scene
from airline.scenes.camera import CLEAN, MOTIONS, CameraEffects, blur_rotation, develop, exposure_at, pose_at
from airline.scenes.rooms import indoor_scene, shelves_scene
from airline.scenes.street import street_scene
from airline.scenes.textures import texture_bank

FRAMES_PER_SECOND = 30
_LAYOUTS = {"indoor": indoor_scene, "street": street_scene, "shelves": shelves_scene}


@dataclass(frozen=True)
class RenderedView:
    """One frame with its ground truth.

    Attributes:
        image: (H, W, 3) uint8 BGR.
        depth: (H, W) float32 distance along the optical axis, m; inf where there is sky.
        segments_px: (N, 2, 2) float32 visible pieces of lines, px.
        segments_world: (N, 2, 3) float64 the same end points in space, m.
        ids: (N,) int64 the physical line (or outline of a pipe) of each piece, the same over the whole clip.
        K: (3, 3) float64 intrinsic matrix, px.
        pose: (4, 4) float64 world_from_camera; camera x right, y down, z forward.
        stamp_ns: time since the sequence's start, ns.
    """

    image: NDArray[np.uint8]
    depth: NDArray[np.float32]
    segments_px: NDArray[np.float32]
    segments_world: Array
    ids: NDArray[np.int64]
    K: Array
    pose: Array
    stamp_ns: int


@dataclass(frozen=True)
class RenderedClip:
    """A generated video; making one is cheap, and `render(i)` depends on the fields and `i` alone.

    Attributes:
        kind: "indoor", "street" or "shelves".
        motion: "static", "slow", "handheld" or "fast".
        seed: chooses the scene, the path and the noise.
        frames: length, at 30 frames per second.
        size: (width, height), px.
        effects: the camera's imperfections; None for the clean image. The ground truth does not depend on it.
        min_contrast: lines whose sides differ by less in the clean image are not ground truth, grey levels.
        merge_doubles: of lines closer than 1.5 px only the longest is ground truth; else all are.
        baseline_m: how far a second camera lies to the right of the first one; both are alike and rigidly joined.
    """

    kind: str = "indoor"
    motion: str = "handheld"
    seed: int = 0
    frames: int = 300
    size: tuple[int, int] = (640, 480)
    effects: CameraEffects | None = field(default_factory=CameraEffects)
    min_contrast: float = 12.0
    merge_doubles: bool = True
    baseline_m: float = 0.12

    def __post_init__(self) -> None:
        if self.kind not in _LAYOUTS:
            raise ConfigError(f"unknown kind of scene '{self.kind}': use one of {', '.join(_LAYOUTS)}")
        if self.motion not in MOTIONS:
            raise ConfigError(f"unknown motion '{self.motion}': use one of {', '.join(MOTIONS)}")
        if self.frames < 1:
            raise ConfigError(f"a sequence needs at least 1 frame, not {self.frames}")
        if min(self.size) < 32:
            raise ConfigError(f"images must be at least 32 px wide and high, not {self.size[0]}x{self.size[1]}")
        if self.seed < 0:
            raise ConfigError(f"the seed must not be negative, but is {self.seed}")
        if not 0 < self.baseline_m < np.inf:
            raise ConfigError(f"the second camera must lie to the right of the first one, not {self.baseline_m} m")

    def __len__(self) -> int:
        return self.frames

    def __iter__(self) -> Iterator[RenderedView]:
        return (self.render(i) for i in range(self.frames))

    @property
    def K(self) -> Array:  # noqa: N802
        """(3, 3) float64 intrinsic matrix, px; the focal length is part of what the seed chooses."""
        width, height = self.size
        focal = width * np.random.default_rng([self.seed, 3]).uniform(0.65, 0.9)
        return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])

    def pose(self, i: float, *, right: bool = False) -> Array:
        """(4, 4) float64 world_from_camera of frame `i`; fractions are times between frames."""
        walk = build_scene(self.kind, self.seed).walk
        pose = pose_at(walk, MOTIONS[self.motion], self.seed, i / FRAMES_PER_SECOND)
        pose[:3, 3] += right * self.baseline_m * pose[:3, 0]
        return pose

    def render(self, i: int, *, right: bool = False) -> RenderedView:
        """Frame `i` in [0, frames), of the first or the second camera; IndexError outside.

        Both have the same exposure and ids of lines, and each its own noise.
        """
        if not 0 <= i < self.frames:
            raise IndexError(f"frame {i} of a sequence of {self.frames}")
        stamp = round(i * 1_000_000_000 / FRAMES_PER_SECOND)
        K, pose = self.K, self.pose(i, right=right)
        scene = build_scene(self.kind, self.seed)
        linear, clean = render_scene(scene, pose, K, self.size, self.min_contrast, self.merge_doubles)
        if self.effects is None:
            return replace(clean, stamp_ns=stamp)
        blurred = blur_rotation(linear, K, self._turns(self.effects, i))
        exposure = exposure_at(self.effects, self.seed, i / FRAMES_PER_SECOND)
        return replace(clean, image=develop(blurred, exposure, self.effects, self.seed, i, right=right), stamp_ns=stamp)

    def _turns(self, effects: CameraEffects, i: int) -> list[Array]:
        """Rotations of the camera while the shutter is open around frame i: about one for every 1.5 px of motion."""
        half = effects.motion_blur / 2
        centre = self.pose(i)[:3, :3]
        sweep = self.pose(i + half)[:3, :3].T @ self.pose(i - half)[:3, :3]
        angle = float(np.arccos(np.clip((np.trace(sweep) - 1) / 2, -1, 1)))
        count = min(12, int(np.ceil(angle * self.K[0, 0] / 1.5)))
        times = [((k + 0.5) / count - 0.5) * 2 * half for k in range(count)] if count > 1 else []
        return [self.pose(i + t)[:3, :3].T @ centre for t in times]


@lru_cache(maxsize=8)
def build_scene(kind: str, seed: int) -> Scene:
    """The scene of a kind and seed."""
    return _LAYOUTS[kind](np.random.default_rng([seed, list(_LAYOUTS).index(kind)]))


def render_scene(
    scene: Scene, pose: Array, K: Array, size: tuple[int, int], min_contrast: float, merge_doubles: bool = True
) -> tuple[NDArray[np.float32], RenderedView]:
    """The clean view of a scene from `pose` (world_from_camera) by a camera with square pixels; see `RenderedClip`.

    Returns (H, W, 3) float32 linear BGR, and the view at time 0 with that image under a plain display curve.
    """
    focal, centre, (cx, cy) = K[0, 0], K[:2, 2], K[:2, 2]
    rotation = np.ascontiguousarray(pose[:3, :3].T)
    translation = -rotation @ pose[:3, 3]
    faces, inverse, bounds, depths = raster.project_faces(scene, rotation, translation, focal, centre, size)
    functions = raster.pixel_functions(inverse, focal, centre)
    material = (scene.materials[faces], scene.textures[faces], texture_bank())
    sky = (raster.sky_function(pose, focal, centre), scene.sky)
    linear, depth = raster.draw(functions, bounds, raster.SAMPLES, *material, *sky, *size)
    image = develop(linear, 1.0, CLEAN, 0, 0)

    outlines = visibility.pipe_outlines(scene.pipes, scene.radii, pose[:3, 3]).reshape(-1, 2, 3)
    lines = raster.to_camera(np.concatenate([scene.lines, outlines]), rotation, translation)
    ids, points = visibility.clip_to_view(lines, focal, cx, cy, *size)
    rows, pieces = visibility.remove_hidden(points, inverse, bounds, depths, focal, cx, cy)
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    ids, pieces = visibility.keep_contrast(ids[rows], pieces, grey, min_contrast, focal, cx, cy)
    pixels = (focal * pieces[:, :, :2] / pieces[:, :, 2:] + centre).astype(np.float32)
    keep = visibility.drop_doubles(pixels) if merge_doubles else np.ones(len(pixels), np.bool_)
    world = pieces[keep] @ pose[:3, :3].T + pose[:3, 3]
    return linear, RenderedView(image, depth, pixels[keep], world, ids[keep], K, pose, 0)


def render_clip(sequence: RenderedClip, workers: int = 2) -> Iterator[RenderedView]:
    """All frames in order, rendered ahead in `workers` threads: the same bits as iterating, sooner."""
    return map_ahead(sequence.render, range(len(sequence)), workers)


def render_pairs(sequence: RenderedClip, workers: int = 2) -> Iterator[tuple[RenderedView, RenderedView]]:
    """As `render_clip`, of both cameras."""
    eyes = [(i, right) for i in range(len(sequence)) for right in (False, True)]
    views = map_ahead(lambda eye: sequence.render(eye[0], right=eye[1]), eyes, workers)
    return zip(views, views, strict=True)

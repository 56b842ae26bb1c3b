"""The simulated camera: how it moves, and what it does to the clean linear image.

Motion is a closed formula of time, so that any frame's pose is known without the frames before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import inf

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.kernels.compiled import njit
from airline.scenes.builder import Array, Walk

_CURVE = 4096
_LIMITS = {
    "exposure": (1e-6, inf), "exposure_jitter": (0, inf), "noise_sigma": (0, inf), "motion_blur": (0, 1),
    "lens_blur": (0, inf), "vignetting": (0, 1), "gamma": (1e-6, inf),
}  # fmt: skip


@dataclass(frozen=True)
class CameraEffects:
    """Imperfections of the simulated camera.

    Attributes:
        exposure: factor on the light that falls in.
        exposure_jitter: amplitude of slow exposure changes, in stops (0.3: between 2^-0.3 and 2^0.3).
        noise_sigma: standard deviation of the Gaussian noise of each channel, grey levels.
        motion_blur: share of the frame interval during which the shutter is open, 0 to 1; rotation is blurred.
        lens_blur: standard deviation of the lens's Gaussian blur, px.
        vignetting: loss of light in the corners, 0 to 1.
        gamma: exponent of the display curve; 1 is linear.
    """

    exposure: float = 1.0
    exposure_jitter: float = 0.15
    noise_sigma: float = 2.5
    motion_blur: float = 0.25
    lens_blur: float = 0.4
    vignetting: float = 0.2
    gamma: float = 2.2

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            if not low <= getattr(self, name) <= high:
                raise ConfigError(f"camera effect '{name}' must be {low:g} to {high:g}, not {getattr(self, name)}")


CLEAN = CameraEffects(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.2)


@dataclass(frozen=True)
class Motion:
    """How a camera is moved.

    Attributes:
        speed: peak walking speed, m/s.
        turn: peak yaw rate, rad/s.
        shake: amplitude of hand shake, rad.
        bob: amplitude of the head's bobbing while walking, m.
    """

    speed: float
    turn: float
    shake: float
    bob: float


MOTIONS = {
    "static": Motion(0.0, 0.0, 0.0, 0.0),
    "slow": Motion(0.25, 0.08, 0.0, 0.0),
    "handheld": Motion(0.7, 0.28, 0.006, 0.015),
    "fast": Motion(0.8, 1.7, 0.010, 0.015),
}


def pose_at(walk: Walk, motion: Motion, seed: int, seconds: float) -> Array:
    """(4, 4) float64 world_from_camera at a time; camera x right, y down, z forward.

    The camera swings through its free space and looks around in sines of seeded phase, with speeds bounded by `motion`.
    """
    rng = np.random.default_rng([seed, 7])
    phase = rng.uniform(0, 2 * np.pi, 4)
    position = np.array(walk.centre)
    for axis, share in enumerate((1.0, 0.8, 0.15)):
        reach = walk.reach[axis]
        if reach > 0:
            position[axis] += reach * np.sin(phase[axis] + share * motion.speed / reach * seconds)
    yaw = walk.yaw + walk.sweep * np.sin(phase[3] + motion.turn / walk.sweep * seconds)
    pitch, roll = rng.uniform(-0.06, 0.03), rng.uniform(-0.015, 0.015)
    for frequency in (0.7, 1.7, 3.1, 5.3):
        swing = motion.shake / frequency * np.sin(2 * np.pi * frequency * seconds + rng.uniform(0, 2 * np.pi, 3))
        yaw, pitch, roll = yaw + swing[0], pitch + swing[1], roll + swing[2]
    position[2] += motion.bob * np.sin(2 * np.pi * 1.8 * seconds + rng.uniform(0, 2 * np.pi))
    pose = np.eye(4)
    pose[:3, :3] = rotation(yaw, pitch, roll)
    pose[:3, 3] = position
    return pose


def rotation(yaw: float, pitch: float, roll: float) -> Array:
    """(3, 3) float64 world_from_camera: heading `yaw`, tilted up by `pitch`, turned clockwise by `roll`, rad."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=1)


def blur_rotation(linear: NDArray[np.float32], K: Array, turns: list[Array]) -> NDArray[np.float32]:
    """Mean of the image as seen by cameras turned by `turns` (each (3, 3), turned_from_centre); unchanged for none."""
    if not turns:
        return linear
    height, width = linear.shape[:2]
    mean = np.zeros_like(linear)
    for turn in turns:
        homography = K @ turn @ np.linalg.inv(K)
        seen = cv2.warpPerspective(linear, homography, (width, height), borderMode=cv2.BORDER_REPLICATE)
        cv2.accumulate(seen, mean)
    mean /= np.float32(len(turns))
    return mean


def exposure_at(effects: CameraEffects, seed: int, seconds: float) -> float:
    """Exposure factor at a time: two slow sines of seeded phase, in stops."""
    phase = np.random.default_rng([seed, 11]).uniform(0, 2 * np.pi, 2)
    swing = 0.6 * np.sin(2 * np.pi * 0.21 * seconds + phase[0]) + 0.4 * np.sin(2 * np.pi * 0.53 * seconds + phase[1])
    return float(effects.exposure * 2 ** (effects.exposure_jitter * swing))


def develop(
    linear: NDArray[np.float32], exposure: float, effects: CameraEffects, seed: int, frame: int, *, right: bool = False
) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 BGR picture of a linear image under an exposure; `seed`, `frame`, `right` choose the noise."""
    if effects.lens_blur > 0:
        linear = np.asarray(cv2.GaussianBlur(linear, (0, 0), effects.lens_blur), np.float32)
    key = np.uint64(np.random.SeedSequence([seed, frame, 13 + right]).generate_state(1, np.uint64)[0])
    image = np.empty(linear.shape, np.uint8)
    _develop(linear, exposure, effects.vignetting, _curve(effects.gamma), effects.noise_sigma, key, image)
    return image


@lru_cache(maxsize=8)
def _curve(gamma: float) -> NDArray[np.float32]:
    return (255 * (np.arange(_CURVE + 1) / _CURVE) ** (1 / gamma)).astype(np.float32)


@njit()
def _develop(linear, exposure, vignetting, curve, sigma, key, image):  # type: ignore[no-untyped-def]
    height, width = linear.shape[:2]
    cy, cx = 0.5 * (height - 1), 0.5 * (width - 1)
    corner = 1 / (cy * cy + cx * cx)
    # Four 16-bit uniform numbers: their sum is normal enough, and one hash per value makes it free of state.
    scale = np.float32(sigma / (65536 * np.sqrt(1 / 3)))
    for y in range(height):
        for x in range(width):
            gain = np.float32(exposure * (1 - vignetting * ((y - cy) ** 2 + (x - cx) ** 2) * corner) * (len(curve) - 1))
            for c in range(3):
                level = linear[y, x, c] * gain
                value = curve[int(min(level, np.float32(len(curve) - 1)))]
                if sigma > 0:
                    h = key + np.uint64((y * width + x) * 3 + c) * np.uint64(0x9E3779B97F4A7C15)
                    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
                    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
                    h ^= h >> np.uint64(31)
                    low = np.uint64(0xFFFF)
                    total = (
                        (h & low) + ((h >> np.uint64(16)) & low) + ((h >> np.uint64(32)) & low) + (h >> np.uint64(48))
                    )
                    value += (np.float32(total) - np.float32(131070)) * scale
                image[y, x, c] = np.uint8(min(max(value + np.float32(0.5), np.float32(0)), np.float32(255)))

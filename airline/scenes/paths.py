"""Camera motion: closed formulas of time, so that any frame's pose is known without the frames before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.scenes.primitives import Walk


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


def motion(name: str) -> Motion:
    """The motion of that name; ConfigError if there is none."""
    if name not in MOTIONS:
        raise ConfigError(f"unknown motion '{name}': use one of {', '.join(MOTIONS)}")
    return MOTIONS[name]


def pose_at(walk: Walk, kind: Motion, seed: int, seconds: float) -> NDArray[np.float64]:
    """(4, 4) float64 world_from_camera at a time; camera x right, y down, z forward.

    The camera swings through its free space and looks around in sines of seeded phase, with speeds bounded by `kind`.
    """
    rng = np.random.default_rng([seed, 7])
    phase = rng.uniform(0, 2 * np.pi, 4)
    position = np.array(walk.centre)
    for axis, share in enumerate((1.0, 0.8, 0.15)):
        reach = walk.reach[axis]
        if reach > 0:
            position[axis] += reach * np.sin(phase[axis] + share * kind.speed / reach * seconds)
    yaw = walk.yaw + walk.sweep * np.sin(phase[3] + kind.turn / walk.sweep * seconds)
    pitch, roll = rng.uniform(-0.06, 0.03), rng.uniform(-0.015, 0.015)
    for frequency in (0.7, 1.7, 3.1, 5.3):
        swing = kind.shake / frequency * np.sin(2 * np.pi * frequency * seconds + rng.uniform(0, 2 * np.pi, 3))
        yaw, pitch, roll = yaw + swing[0], pitch + swing[1], roll + swing[2]
    position[2] += kind.bob * np.sin(2 * np.pi * 1.8 * seconds + rng.uniform(0, 2 * np.pi))
    pose = np.eye(4)
    pose[:3, :3] = rotation(yaw, pitch, roll)
    pose[:3, 3] = position
    return pose


def rotation(yaw: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """(3, 3) float64 world_from_camera: heading `yaw`, tilted up by `pitch`, turned clockwise by `roll`, rad."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=1)

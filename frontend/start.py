"""The start of a monocular map: the poses of the first frames, from tracked lines, and from points where there are.

    frames = []
    for tracks in LineFrontend().stream(source):
        frames.append(tracks)
        begun = start(frames)
        if not begun.waits:
            break
        del frames[: begun.drop]

Lines say nothing of two views, for any two planes meet. Points do; corners, where lines meet, do; parallel lines tell
the rotation by their vanishing directions. Each may be wrong, so each is a candidate, which is adjusted to what three
views saw, the first, the last and one between (`frontend.starting.agreement`). The one that agrees best is taken, if it
is known well enough, and if no other motion agrees as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from frontend.starting.agreement import adjusted, residuals
from frontend.starting.candidates import NEAR, Space, beside, candidates, directions, inverse_depths, turned
from frontend.starting.views import Seen, View, common
from frontend.tracks import LineTracks

LEAST_FRAMES, MOST_FRAMES = 5, 60  # of a start; of those that wait: the oldest are of no more use
LEAST_LINES, LEAST_TRACKS = 8, 12  # that go on from the first frame to the last: lines, and lines and points
LOOKED_AT = 7  # frames, of which one becomes the middle one
PARALLAX = 4.0  # standard deviations by which a fifth of lines and points must be off a turn on the spot
KNOWN = 8.0  # standard deviations of the inverse depth of half of them
MAX_ERROR = np.deg2rad(1.0)  # standard deviation of the direction of motion
AHEAD = 0.75  # of what there would be if all lay before the camera for sure
OTHER = np.deg2rad(5)  # between two directions of motion that are not the same
ALIKE = 20.0  # difference of costs from which one motion is better than another, times what one residual costs
AGREES = 9.2  # squared distance, two degrees of freedom, 99 %
LEAST_AGREEMENT = 0.6

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Begun:
    """How a map begins, or why it waits.

    Attributes:
        poses: (K, 3, 4) float64 world_from_camera of all frames, in the first one's axes; from the first to the last it
            is 1, for one camera does not tell the scale. (0, 3, 4) while it waits.
        by: "points", "corners" or "vanishing directions": what told the motion; "" before anything does.
        agreement: share of the lines that three views agree on.
        error: standard deviation of the direction of motion, radians.
        waits: "" once begun, else why not.
        drop: how many of the oldest frames are of no more use: leave them out of the next call.
    """

    poses: Array = field(default_factory=lambda: np.zeros((0, 3, 4)))
    by: str = ""
    agreement: float = 0.0
    error: float = np.inf
    waits: str = ""
    drop: int = 0


def start(frames: Sequence[LineTracks]) -> Begun:
    """The poses of all frames, or why they cannot be known yet.

    Args:
        frames: consecutive ones, each with a camera; the first is the world. Call it again with each new one, without
            those that `Begun.drop` says. Points (`TrackerConfig.points`) make it surer and sooner, and are not needed.

    Raises:
        ConfigError: a frame without a camera.
    """
    if len(frames) < LEAST_FRAMES:
        for frame in frames:
            View.of(frame)  # says now that there is no camera
        return Begun(waits="too few frames")
    count = len(frames)
    views = {k: View.of(frames[k]) for k in np.unique(np.linspace(0, count - 1, LOOKED_AT).astype(int)).tolist()}
    first, last = views.pop(0), views.pop(count - 1)
    if not _go_on(first, last):
        drop = next((k for k in range(1, count) if _go_on(View.of(frames[k]), last, 2)), count - 1)
        return Begun(waits="too few lines and points go on", drop=drop)
    drop = max(0, count + 1 - MOST_FRAMES)
    turn, parallax = turned(first, last)
    if parallax < PARALLAX:
        angle = np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        said = f"only turned so far, by {angle:.0f} degrees" if angle >= 0.5 else "not moved so far"
        return Begun(waits=f"the camera has {said}", drop=drop)
    middle = max(views, key=lambda k: min(turned(first, views[k])[1], turned(views[k], last)[1]))
    seen = Seen.of([first, views[middle], last])
    found = candidates(seen)
    if not found or len(seen.views[0].ids) < LEAST_LINES:
        return Begun(waits="too few points, corners or parallel lines tell how the camera moved", drop=drop)
    motions, costs, covariances = adjusted(seen, np.stack([motion for _, motion in found]))
    best = int(costs.argmin())
    motion = motions[best]

    depths, sigmas, of_points, own = inverse_depths(seen, motion[1])
    sure = np.concatenate([(depths / sigmas).mean(axis=0), of_points / own])
    ahead = np.clip(sure, -NEAR, NEAR).sum() / (NEAR * len(sure))
    if ahead < 0:  # the images are the same from motions that are opposite: what is seen lies before the camera
        motion[:, :, 3], sure, ahead = -motion[:, :, 3], -sure, -ahead
    squares = (residuals(seen, motion[None])[0][0] ** 2).sum(axis=0)
    agreement = float(((squares < AGREES) & (sure[: len(squares)] > -NEAR)).mean())
    error = float(np.sqrt(np.linalg.eigvalsh(covariances[best]).max()))

    def wait(why: str) -> Begun:
        return Begun(by=found[best][0], agreement=agreement, error=error, waits=why, drop=drop)

    margin = ALIKE * costs[best] / (2 * len(squares) + 3 * len(own))
    if not (error <= MAX_ERROR and np.median(np.abs(sure)) >= KNOWN and ahead >= AHEAD):
        return wait("the camera has moved too little so far")
    if agreement < LEAST_AGREEMENT:
        return wait(f"only {agreement:.0%} of the lines agree on a motion")
    others, other_costs, _ = adjusted(seen, np.concatenate([beside(motion, OTHER), directions(seen)]), held=4)
    others, other_costs = np.concatenate([others, motions]), np.concatenate([other_costs, costs])
    apart = np.arccos(np.clip(np.abs(others[:, 1, :, 3] @ motion[1, :, 3]), 0, 1))
    if ((apart > 0.9 * OTHER) & (other_costs < costs[best] + margin)).any():
        return wait("two motions explain the lines alike")
    space, poses = Space.of(seen, motion[1]), {0: np.eye(3, 4), middle: motion[0], count - 1: motion[1]}
    for k in range(count):
        pose = poses[k] if k in poses else space.pose_of(View.of(frames[k]))
        if pose is None:
            return wait(f"frame {k} sees too few of the lines")
        poses[k] = pose
    return Begun(np.stack([poses[k] for k in range(count)]), found[best][0], agreement, error)


def _go_on(first: View, last: View, times: int = 1) -> bool:
    """Whether enough lines and points, or times as many, go on from one view to another."""
    view = common([first, last])[1]
    lines, points = int(view.confirmed.sum()), len(view.point_ids)
    return lines >= times * LEAST_LINES and lines + points >= times * LEAST_TRACKS

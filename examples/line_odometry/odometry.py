"""The path of a camera from lines that were tracked: one class, one view after the other.

    odometry = LineOdometry(focal)
    for tracks in frontend.stream(source):
        odometry.add(View.of(tracks))
    odometry.trajectory()

The map begins once the first view and a later one tell how the camera moved; a camera that turns on the spot until the
first view's lines are gone never begins. From then on every view's pose comes from the map by RANSAC; every few views
one is kept (a keyframe), new lines are triangulated, and the last keyframes and their lines are adjusted together.
Lines that do not stay one line in space leave the map.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from line_odometry.adjust import adjust
from line_odometry.geometry import Array
from line_odometry.pose import pose_from_lines, poses_of_second
from line_odometry.triangulation import Triangulated, judge, triangulate
from line_odometry.views import Ids, View, gather

KEYFRAME_EVERY = 4  # views, at most
KEYFRAME_SEEN = 0.7  # of the last keyframe's lines still in view; with fewer, a new keyframe comes sooner
WINDOW = 8  # newest keyframes, which are adjusted
ANCHORS = 8  # keyframes before them, which hold them
LEAST_VIEWS = 3  # of a line in the map
MAX_RMS = 1.0  # px
USABLE = 0.2  # spread (see `Triangulated`) of lines that are adjusted
KNOWN = 0.02  # spread of lines that poses are found by
LEAST_KNOWN = 30  # lines, in the current view, before which the best of the others help out
STEPS = 8  # of the optimiser per keyframe


@dataclass(frozen=True)
class Map:
    """The lines in space so far.

    Attributes:
        ids: (N,) tracks, ascending.
        lines: (N, 2, 3) points and directions.
        spread: (N,) how well each is known, see `Triangulated`; infinite for those that are no line.
    """

    ids: Ids = field(default_factory=lambda: np.zeros(0, np.int64))
    lines: Array = field(default_factory=lambda: np.zeros((0, 2, 3)))
    spread: Array = field(default_factory=lambda: np.zeros(0))

    def find(self, ids: Ids) -> tuple[Array, Array]:
        """(M, 2, 3) lines and (M,) spreads of tracks; NaN and infinite for those that are not in the map."""
        place = np.minimum(np.searchsorted(self.ids, ids), max(len(self.ids) - 1, 0))
        known = self.ids[place] == ids if len(self.ids) else np.zeros(len(ids), np.bool_)
        lines, spread = np.full((len(ids), 2, 3), np.nan), np.full(len(ids), np.inf)
        lines[known], spread[known] = self.lines[place[known]], self.spread[place[known]]
        return lines, spread

    def updated(self, ids: Ids, found: Triangulated) -> Map:
        """The map with new or better lines of the given tracks, ascending."""
        spread = np.where(found.ahead & (found.rms < MAX_RMS), found.spread, np.inf)
        rest = ~np.isin(self.ids, ids)
        order = np.argsort(np.concatenate([self.ids[rest], ids]))
        pairs = ((self.ids, ids), (self.lines, found.lines), (self.spread, spread))
        return Map(*(np.concatenate([old[rest], new])[order] for old, new in pairs))


@dataclass(frozen=True)
class _Start:
    """What the odometry may begin with.

    Attributes:
        known: how many lines of the newest view the map knows well.
        cost: how badly all lines fit, px.
        map: the first lines.
        keyframes: views whose poses were adjusted.
        poses: of all views so far.
    """

    known: int
    cost: float
    map: Map
    keyframes: list[int]
    poses: list[Array]


class LineOdometry:
    """Estimates a pose for every view, in the first view's axes.

    Attributes:
        map: the lines so far.
        lost: views whose pose was guessed from the motion before, for want of lines.
    """

    def __init__(self, focal: float) -> None:
        """Weigh distances by a focal length, px."""
        self.map = Map()
        self.lost: list[int] = []
        self._focal = focal
        self._views: list[View] = []
        self._poses: list[Array] = []
        self._keyframes: list[int] = []
        self._keyframe_of: list[int] = []

    def add(self, view: View) -> None:
        """Take the next view."""
        self._views.append(view)
        index = len(self._views) - 1
        if self._poses:
            self._follow(index)
        elif index >= LEAST_VIEWS - 1:
            self._start(index)

    def trajectory(self) -> Array:
        """(N, 3, 4) world_from_camera of all views; fewer or none while there has been too little motion to start."""
        return np.array(self._poses).reshape(-1, 3, 4)

    def _start(self, index: int) -> None:
        """Make the first map if the first view and this one tell enough: the one that all lines agree with best."""
        candidates = poses_of_second(self._views[0], self._views[index], self._focal)
        best: _Start | None = None
        for pose in candidates:
            start = self._start_from(pose, index)
            if start is not None and (best is None or start.cost < best.cost):
                best = start
            if best is None or best.known < LEAST_KNOWN:  # too early
                self.map = Map()
                return
        if best is None:
            return
        self.map = best.map
        self._keyframes = best.keyframes
        self._keyframe_of = [max(frame for frame in best.keyframes if frame <= k) for k in range(index + 1)]
        self._poses = best.poses

    def _start_from(self, second: Array, index: int) -> _Start | None:
        """The map that begins with the first view and one more at a given pose."""
        pair = np.stack([np.eye(3, 4), second])
        seen = gather([self._views[0], self._views[index]], self._focal, least=2)
        self.map = Map().updated(seen.ids, triangulate(seen, pair))
        frames = [*range(0, index, min(KEYFRAME_EVERY, max(1, index // 4))), index]
        between = [self._locate(self._views[frame]) for frame in frames[1:-1]]
        keyposes = [pose for pose in (pair[0], *between, pair[1]) if pose is not None]
        if len(keyposes) < len(frames):
            return None
        keyposes = list(self._adjusted(frames, np.array(keyposes), free=len(frames) - 1, steps=2 * STEPS))
        poses = [pose for view in self._views if (pose := self._locate(view)) is not None]
        if len(poses) < len(self._views):
            return None
        for frame, pose in zip(frames, keyposes, strict=True):
            poses[frame] = pose
        seen = gather(self._views, self._focal, LEAST_VIEWS)
        lines = triangulate(seen, np.array(poses), self.map.find(seen.ids)[0])
        cost = np.where(lines.ahead, np.minimum(lines.rms, MAX_RMS), MAX_RMS).sum()
        known = int((self.map.find(self._views[index].ids)[1] < KNOWN).sum())
        return _Start(known, float(cost), self.map, frames, poses)

    def _follow(self, index: int) -> None:
        """The pose of a view from the map; a keyframe of it if it is time for one."""
        last = self._keyframes[-1]
        pose = self._locate(self._views[index])
        if pose is None:
            self.lost.append(index)
            before, latest = self._poses[-2:]
            self._poses.append(_compose(latest, _compose(_inverse(before), latest)))
            self._keyframe_of.append(last)
            return
        self._poses.append(pose)
        seen = np.isin(self._views[last].ids, self._views[index].ids).mean()
        if index - last < KEYFRAME_EVERY and seen >= KEYFRAME_SEEN:
            self._keyframe_of.append(last)
            return
        self._keyframes.append(index)
        self._keyframe_of.append(index)
        self._improve()

    def _locate(self, view: View) -> Array | None:
        """The pose of a view by the lines of the map that are known well, and the best of the others where few are."""
        lines, spread = self.map.find(view.ids)
        limit = max(KNOWN, np.sort(spread)[:LEAST_KNOWN].max(initial=0.0))
        rows = np.flatnonzero(spread <= min(limit, USABLE))
        return pose_from_lines(view.ends[rows], lines[rows], self._focal)

    def _improve(self) -> None:
        """Adjust the newest keyframes, held by those before them."""
        frames = self._keyframes[-WINDOW - ANCHORS :]
        before = np.array([self._poses[frame] for frame in frames])
        after = self._adjusted(frames, before, min(WINDOW, len(frames) - 1), STEPS)
        changes = {k: _compose(new, _inverse(old)) for k, old, new in zip(frames, before, after, strict=True)}
        for index in range(frames[0], len(self._keyframe_of)):  # each view goes with the keyframe before it
            self._poses[index] = _compose(changes[self._keyframe_of[index]], self._poses[index])

    def _adjusted(self, frames: list[int], poses: Array, free: int, steps: int) -> Array:
        """Poses of keyframes after their lines have been triangulated and the newest so many adjusted with them."""
        views = [self._views[frame] for frame in frames]
        current = np.unique(np.concatenate([view.ids for view in views[-free:]]))
        seen = gather(views, self._focal, LEAST_VIEWS, current)
        found = triangulate(seen, poses, self.map.find(seen.ids)[0])
        usable = found.ahead & (found.rms < MAX_RMS) & (found.spread < USABLE)
        if usable.any():
            lines = found.lines.copy()
            may_move = np.arange(len(frames)) >= len(frames) - free
            lines[usable], poses = adjust(seen.only(usable), lines[usable], poses, may_move, steps)
            found = judge(seen, lines, poses)
        self.map = self.map.updated(seen.ids, found)
        return poses


def _compose(first: Array, second: Array) -> Array:
    return np.column_stack([first[:, :3] @ second[:, :3], first[:, :3] @ second[:, 3] + first[:, 3]])


def _inverse(pose: Array) -> Array:
    return np.column_stack([pose[:, :3].T, -pose[:, :3].T @ pose[:, 3]])

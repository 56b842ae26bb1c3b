"""The path of a camera from lines that were tracked: one class, one view after the other.

    odometry = LineOdometry()
    for tracks in frontend.stream(source):
        odometry.add(tracks)
    odometry.trajectory()

The map begins once the first view and a later one tell how the camera moved (`frontend.start`). From then on every
view's pose comes from the map by RANSAC; every few views one is kept (a keyframe), new lines are triangulated, and the
newest keyframes and their lines are smoothed together. Lines that do not stay one line in space leave the map.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from frontend import LineTracks
from line_odometry.pose import pose_from_lines
from line_odometry.smoother import LAG, Smoother
from line_odometry.triangulation import Triangulated, triangulate
from line_odometry.views import Array, Ids, View, gather

import os
KEYFRAME_EVERY = int(os.environ.get("KE","4"))  # views, at most
KEYFRAME_SEEN = float(os.environ.get("KS","0.7"))  # of the last keyframe's lines still in view; with fewer, a new keyframe comes sooner
LEAST_VIEWS = 3  # of a line in the map
MAX_RMS = 1.0  # px
import os
USABLE = float(os.environ.get("USABLE","0.03"))  # spread (see `Triangulated`) of lines that are smoothed
KNOWN = float(os.environ.get("KN","0.02"))  # spread of lines that poses are found by
LEAST_KNOWN = 30  # lines, in the current view, before which the best of the others help out


@dataclass(frozen=True)
class Map:
    """The lines in space so far.

    Attributes:
        ids: (N,) tracks, ascending.
        ends: (N, 2, 3) points.
        spread: (N,) how well each is known, see `Triangulated`; infinite for those that are no line.
    """

    ids: Ids = field(default_factory=lambda: np.zeros(0, np.int64))
    ends: Array = field(default_factory=lambda: np.zeros((0, 2, 3)))
    spread: Array = field(default_factory=lambda: np.zeros(0))

    def find(self, ids: Ids) -> tuple[Array, Array]:
        """(M, 2, 3) points and (M,) spreads of tracks; NaN and infinite for those that are not in the map."""
        place = np.minimum(np.searchsorted(self.ids, ids), max(len(self.ids) - 1, 0))
        known = self.ids[place] == ids if len(self.ids) else np.zeros(len(ids), np.bool_)
        ends, spread = np.full((len(ids), 2, 3), np.nan), np.full(len(ids), np.inf)
        ends[known], spread[known] = self.ends[place[known]], self.spread[place[known]]
        return ends, spread

    def updated(self, ids: Ids, ends: Array, spread: Array) -> Map:
        """The map with new or better lines of the given tracks, ascending."""
        rest = ~np.isin(self.ids, ids)
        order = np.argsort(np.concatenate([self.ids[rest], ids]))
        pairs = ((self.ids, ids), (self.ends, ends), (self.spread, spread))
        return Map(*(np.concatenate([old[rest], new])[order] for old, new in pairs))


class LineOdometry:
    """Estimates a pose for every view, in the first view's axes.

    Attributes:
        map: the lines so far.
        lost: views whose pose was guessed from the motion before, for want of lines.
    """

    def __init__(self, focal: float, start) -> None:
        self.map = Map()
        self.lost: list[int] = []
        self._focal = focal
        self._start = start
        self._tracks: list[LineTracks] = []
        self._views: list[View] = []
        self._keyframes: list[int] = []  # their views
        self._keyposes: list[Array] = []
        self._places: list[tuple[int, Array]] = []  # of each view: number of its keyframe, and its pose in that one's axes

    def add(self, tracks: LineTracks) -> None:
        """Take the next view."""
        self._views.append(View.of(tracks))
        index = len(self._views) - 1
        if self._places:
            self._follow(index)
            return
        self._tracks.append(tracks)
        begun = self._start(self._tracks)
        if len(begun.poses):
            self._begin(begun.poses)

    def trajectory(self) -> Array:
        """(N, 3, 4) world_from_camera of all views, by the map as it is now; none while there was no start."""
        poses = [self._pose(index) for index in range(len(self._places))]
        for index in set(range(len(poses))) - {*self._keyframes, *self.lost}:
            found = self._locate(self._views[index], poses[index])
            poses[index] = poses[index] if found is None else found
        return np.array(poses).reshape(-1, 3, 4)

    def _pose(self, index: int) -> Array:
        return _compose(self._keyposes[self._places[index][0]], self._places[index][1])

    def _begin(self, poses: Array) -> None:
        last = len(poses) - 1
        self._keyframes = [*range(0, last, min(KEYFRAME_EVERY, max(1, last // 4))), last]
        self._keyposes = [poses[frame] for frame in self._keyframes]
        for index, pose in enumerate(poses):
            number = max(k for k, frame in enumerate(self._keyframes) if frame <= index)
            self._places.append((number, _compose(_inverse(self._keyposes[number]), pose)))
        self._motion = np.eye(3, 4)
        self._smoother = Smoother(poses[0], poses[last], len(self._keyframes) - 1)
        self._improve(len(self._keyframes))

    def _follow(self, index: int) -> None:
        """The pose of a view from the map; a keyframe of it if it is time for one."""
        number = len(self._keyframes) - 1
        last, pose = self._keyframes[-1], self._locate(self._views[index], _compose(self._pose(-1), self._motion))
        n_lost=len(self.lost)
        if pose is None:
            self.lost.append(index)
            pose = _compose(self._pose(-1), self._motion)
        else:
            self._motion = _compose(_inverse(self._pose(-1)), pose)
        if pose is not None and len(self.lost)==n_lost and (
            index - last >= KEYFRAME_EVERY
            or self._share_seen(last, index) < KEYFRAME_SEEN
        ):
            self._keyframes.append(index)
            self._keyposes.append(pose)
            self._places.append((number + 1, np.eye(3, 4)))
            self._improve(1)
            return
        self._places.append((number, _compose(_inverse(self._keyposes[number]), pose)))

    def _share_seen(self, last, index):
        known = self._views[last].ids[np.isfinite(self.map.find(self._views[last].ids)[1])]
        return np.isin(known, self._views[index].ids).mean()

    def _locate(self, view: View, near: Array) -> Array | None:
        """The pose of a view by the lines of the map that are known well, and the best of the others where few are."""
        ends, spread = self.map.find(view.ids)
        limit = max(KNOWN, np.sort(spread)[:LEAST_KNOWN].max(initial=0.0))
        rows = np.flatnonzero(spread <= min(limit, USABLE))
        return pose_from_lines(view.ends[rows], view.variances[rows], ends[rows], self._focal, near)

    def _improve(self, new: int) -> None:
        """Take the newest keyframes into the graph; all views since the oldest in it go with them."""
        numbers = range(max(0, len(self._keyframes) - LAG), len(self._keyframes))
        views, poses = [self._views[self._keyframes[number]] for number in numbers], np.array(self._keyposes[numbers[0] :])
        current = np.unique(np.concatenate([view.ids for view in views[-new:]]))
        seen = gather(views, LEAST_VIEWS, current)
        found = triangulate(seen, poses)
        usable = self._usable(found)
        poses, _ = self._smoother.update(numbers, poses, seen.only(usable), found.ends[usable])
        self._keyposes[numbers[0] :] = list(poses)
        found = triangulate(seen, poses)
        self.map = self.map.updated(seen.ids, found.ends, np.where(self._usable(found), found.spread, np.inf))

    def _usable(self, found: Triangulated):
        return found.ahead & (self._focal * found.rms < MAX_RMS) & (found.spread < USABLE)


def _compose(first: Array, second: Array) -> Array:
    return np.column_stack([first[:, :3] @ second[:, :3], first[:, :3] @ second[:, 3] + first[:, 3]])


def _inverse(pose: Array) -> Array:
    return np.column_stack([pose[:, :3].T, -pose[:, :3].T @ pose[:, 3]])

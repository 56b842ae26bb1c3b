"""The path of a camera from tracked lines, and from points where they are given: one class, one frame after the other.

    odometry = LineOdometry(focal)
    for tracks in frontend.stream(source):
        odometry.add(tracks)
    odometry.trajectory()

`frontend.start` begins. From then on every frame's pose comes from the map by RANSAC; every few frames one is kept (a
keyframe), new lines are triangulated, and the newest keyframes and what they see are smoothed together. Lines that do
not stay one line in space leave the map. Where nothing in view is in the map for long, another map begins behind it.

A rectified pair is two views under one pose: its first frame makes a map, in metres, and so does each keyframe of lines
that are new.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend import LineTracks
from frontend.start import start
from line_odometry.pose import LEAST, pose_from_map
from line_odometry.residual import line_ids, line_marks, point_marks
from line_odometry.smoother import LAG, LEAST_VIEWS, Smoother
from line_odometry.triangulation import Triangulated, triangulate, triangulate_points
from line_odometry.views import Array, Ids, View, both_cameras, gather, take

KEYFRAME_EVERY = 4  # frames, at most
KEYFRAME_SEEN = 0.7  # of the map's lines in the last keyframe still in view; with fewer, a new keyframe comes sooner
MAX_RMS = 1.0  # px
USABLE = (
    0.03  # spread (see `Triangulated`) of what is smoothed: GTSAM's Cholesky takes depths that are not known for none
)
KNOWN = 0.02  # spread of what poses are found by
LEAST_KNOWN = 30  # lines, in the current view, before which the best of the others help out
MOST_SMOOTHED = 150  # lines, those known best
LOST = 10, 2  # frames without a pose before another map begins, for one camera and for a pair


@dataclass(frozen=True)
class Map:
    """The lines, or points, in space so far.

    Attributes:
        ids: (N,) tracks, ascending.
        ends: (N, E, 3) two points of each line, or the point.
        spread: (N,) how well each is known, see `Triangulated`; infinite for those that are no line.
    """

    ids: Ids
    ends: Array
    spread: Array

    def find(self, ids: Ids) -> tuple[Array, Array]:
        """(M, E, 3) points and (M,) spreads of tracks; NaN and infinite for those that are not in the map."""
        place = np.minimum(np.searchsorted(self.ids, ids), max(len(self.ids) - 1, 0))
        known = self.ids[place] == ids if len(self.ids) else np.zeros(len(ids), np.bool_)
        ends, spread = np.full((len(ids), *self.ends.shape[1:]), np.nan), np.full(len(ids), np.inf)
        ends[known], spread[known] = self.ends[place[known]], self.spread[place[known]]
        return ends, spread

    def updated(self, ids: Ids, found: Triangulated, usable: NDArray[np.bool_]) -> Map:
        """The map with new or better places of the given tracks, ascending."""
        rest = ~np.isin(self.ids, ids)
        order = np.argsort(np.concatenate([self.ids[rest], ids]))
        new = ids, found.ends, np.where(usable, found.spread, np.inf)
        old = self.ids, self.ends, self.spread
        return Map(*(np.concatenate([one[rest], other])[order] for one, other in zip(old, new, strict=True)))


def empty_map(points: int) -> Map:
    """A map of lines (two points each), or of points (one)."""
    return Map(np.zeros(0, np.int64), np.zeros((0, points, 3)), np.zeros(0))


class LineOdometry:
    """Estimates a pose for every frame from the first one that it could begin with, in that one's axes.

    Attributes:
        first: that frame.
        map, points: the lines so far, and the points.
        lost: frames whose pose was guessed from the motion before, for want of anything that the map knows.
        begun: frames with which maps began; what comes from the second on is placed by such a guess, and of one camera
            scaled by it.
        failed: keyframes that GTSAM could not solve for; the graph began anew there.
        waits: why it has not begun.
        baseline_m: of the pair of cameras; 0: of one camera, and no metres.
    """

    def __init__(self, focal: float, *, points: bool = False) -> None:
        """Weigh distances by a focal length, px; map points, too."""
        self.map, self.points = empty_map(2), empty_map(1)
        self.first = 0
        self.lost: list[int] = []
        self.begun: list[int] = []
        self.failed: list[int] = []
        self.waits = "no frame came"
        self.baseline_m = 0.0
        self._oldest = 0  # keyframe in the graph
        self._focal, self._with_points = focal, points
        self._waiting: list[LineTracks] = []  # to begin
        self._views: list[tuple[View, ...]] = []  # of each frame: its left one, and the right one of a pair
        self._keyframes: list[int] = []
        self._keyposes: list[Array] = []
        # of each view: its keyframe, by number, and its pose in that one's axes
        self._places: list[tuple[int, Array]] = []
        self._motion = np.eye(4)  # from the frame before to the last one

    def add(self, tracks: LineTracks) -> None:
        """Take the next frame."""
        if not self._places and len(tracks.right_hits) and tracks.camera is not None:
            self.baseline_m = tracks.camera.baseline_m
        self._views.append(View.pair_of(tracks) if self.baseline_m else (View.of(tracks),))
        near = self._pose(-1) @ self._motion if self._places else np.eye(4)
        pose = self._locate(self._views[-1][0], near) if self._places else None
        if pose is not None:
            self._waiting.clear()
            self._motion = np.linalg.inv(self._pose(-1)) @ pose
            self._follow(pose)
            return
        if self._places:
            self.lost.append(len(self._places))
            self._place(near)
        self._waiting.append(tracks)
        if not self._places or len(self._waiting) > LOST[self.baseline_m > 0]:
            self._begin()

    def trajectory(self) -> Array:
        """(N, 3, 4) world_from_camera of all frames from `first` on, by the map as it is now."""
        poses = [self._pose(index) for index in range(len(self._places))]
        for index in set(range(len(poses))) - {*self._keyframes, *self.lost}:
            found = self._locate(self._views[index][0], poses[index])
            poses[index] = poses[index] if found is None else found
        return np.array(poses).reshape(-1, 4, 4)[:, :3]

    def _pose(self, index: int) -> Array:
        number, place = self._places[index]
        return self._keyposes[number] @ place

    def _place(self, pose: Array) -> None:
        """Put the next view where it goes with the last keyframe."""
        self._places.append((len(self._keyposes) - 1, np.linalg.inv(self._keyposes[-1]) @ pose))

    def _begin(self) -> None:
        """Begin a map with the frames that wait, if they tell how the camera moved; of a pair with the last one."""
        if self.baseline_m:
            known, drop = self._waiting[-1].depth_known, -LOST[1]
            found = np.eye(3, 4)[None]
            self.waits = "too few lines have a depth" if known is None or known.sum() < LEAST else ""
        else:
            begun = start(self._waiting)
            self.waits, drop, found = begun.waits, begun.drop, begun.poses
        if self.waits:
            del self._waiting[:drop]
            return
        poses = np.tile(np.eye(4), (len(found), 1, 1))
        poses[:, :3] = found
        if self._places:  # where the camera was taken to be, and as fast as it was
            poses[:, :3, 3] *= (len(poses) - 1) * np.linalg.norm(self._motion[:3, 3])
            poses = self._pose(-len(poses)) @ poses
            del self._places[-len(poses) :], self.lost[-len(poses) :]
        else:
            self.first = len(self._views) - len(poses)
            del self._views[: self.first]
        frame, last = len(self._places), len(poses) - 1
        kept = {*range(0, last, min(KEYFRAME_EVERY, max(1, last // 4))), last}
        for index, pose in enumerate(poses):
            if index in kept:
                self._keyframes.append(frame + index)
                self._keyposes.append(pose)
            self._place(pose)
        self.begun.append(self.first + frame)
        self._oldest = len(self._keyframes) - len(kept)
        self._smoother = Smoother(np.array(self._keyposes[self._oldest :]), self._oldest, self.baseline_m)
        self._waiting.clear()
        self._improve(len(kept))

    def _follow(self, pose: Array) -> None:
        """Keep a view whose pose is known; make it a keyframe if it is time for one."""
        index, last = len(self._places), self._keyframes[-1]
        before, now = self._views[last][0].lines.ids, self._views[index][0].lines.ids
        seen = np.isin(before[np.isfinite(self.map.find(before)[1])], now)
        if index - last >= KEYFRAME_EVERY or seen.sum() <= KEYFRAME_SEEN * len(seen):
            self._keyframes.append(index)
            self._keyposes.append(pose)
            self._place(pose)
            self._improve(1)
        else:
            self._place(pose)

    def _locate(self, view: View, near: Array) -> Array | None:
        """The pose of a view by what the map knows well, and by the best of the other lines where few are."""
        ends, spread = self.map.find(view.lines.ids)
        limit = max(KNOWN, np.sort(spread)[:LEAST_KNOWN].max(initial=0.0))
        rows = np.flatnonzero(spread <= min(limit, 1.0))
        points, errors = self.points.find(view.points.ids)
        return pose_from_map(
            take(view.lines, rows),
            ends[rows],
            take(view.points, errors < KNOWN),
            points[errors < KNOWN, 0],
            self._focal,
            near,
        )

    def _improve(self, new: int) -> None:
        """Take the newest keyframes into the graph; the views since the oldest in it go with them."""
        first = max(self._oldest, len(self._keyframes) - LAG)
        fresh = [self._views[frame][0] for frame in self._keyframes[-new:]]
        views = [view for frame in self._keyframes[first:] for view in self._views[frame]]
        poses = np.array(self._keyposes[first:])[:, :3]
        cameras, least = both_cameras(poses, self.baseline_m), LEAST_VIEWS[self.baseline_m > 0]
        lines = gather([view.lines for view in views], least, _ids([view.lines.ids for view in fresh]))
        found = triangulate(lines, cameras)
        best = self._usable(found) & (np.argsort(np.argsort(found.spread)) < MOST_SMOOTHED)
        ends = self._smoother.places(line_ids(lines.ids[best]), found.ends[best], first)
        marks = [line_marks(lines.only(best), ends, cameras)]
        if self._with_points:
            points = gather([view.points for view in views], LEAST_VIEWS[0], _ids([view.points.ids for view in fresh]))
            places = triangulate_points(points, cameras)
            good = self._usable(places)
            marks.append(point_marks(points.only(good), places.ends[good, 0]))
        try:
            poses = self._smoother.update(first, poses, marks)
        except RuntimeError:  # GTSAM's IndeterminantLinearSystemException
            self.failed.append(self.first + self._keyframes[-1])
            self._oldest = max(first, len(self._keyframes) - LAG // 2)
            self._smoother = Smoother(np.array(self._keyposes[self._oldest :]), self._oldest, self.baseline_m)
        for number, pose in enumerate(poses, first):
            self._keyposes[number] = np.vstack([pose, (0, 0, 0, 1)])
        cameras = both_cameras(poses, self.baseline_m)
        found = triangulate(lines, cameras)
        self.map = self.map.updated(lines.ids, found, self._usable(found, 1.0))
        if self._with_points:
            found = triangulate_points(points, cameras)
            self.points = self.points.updated(points.ids, found, self._usable(found, 1.0))

    def _usable(self, found: Triangulated, most: float = USABLE) -> NDArray[np.bool_]:
        return found.ahead & (self._focal * found.rms < MAX_RMS) & (found.spread < most)


def _ids(tracks: list[Ids]) -> Ids:
    return np.unique(np.concatenate(tracks))

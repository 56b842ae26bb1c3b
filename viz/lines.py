"""Lines as Rerun draws them: tracks, in the colours of their ids, whose state shows at a glance; lines in space."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from frontend.camera.model import CameraModel
from frontend.colours import track_colours
from frontend.space import checked_lines, checked_pose
from frontend.tracking.selection import best
from frontend.tracks import LineTracks
from viz.rerun_private import CORNER, packed, strips_2d, strips_3d

FRAGMENT_TONE = 0.55  # how dark a piece of a broken line is beside whole ones
LOST_TONE, LOST_GREY = 0.2, 120  # how much of its hue a lost line keeps, on which grey
TAIL_TONE = 0.75  # how dark a tail is beside its line
# Radii are in pixels of the image per pixel of its size, which is the root of its area: pictures look alike at any size
BOLD_RADIUS, THIN_RADIUS, FAINT_RADIUS = 0.0020, 0.0006, 0.0004
POINT_RADIUS = 0.0025
BOLD_LINES, SHOWN_LINES = 150, 450  # at most: more would hide the image, or each other
RIGHT, STEREO = "/right", "/world/stereo"  # Rerun shows nothing in space below a pinhole, so not below the camera
LOST_FRAMES = 3  # lost lines are drawn for so many frames: where one should be is a guess, which soon is none
TAIL_FRAMES, TAIL_STEP = 12, 3
TAIL_LENGTH = 0.08  # of the image's size

Size = tuple[int, int]


class TrackLog:
    """Logs the tracks of one stream of frames, fed in time order, at the stream's present time.

    `/camera/tracks`: the best confirmed lines, the best of these bold; `/camera/tracks/rest`: all others that were
    seen. Both say their `track_id` and whether they were `measured` and not detected; pieces of broken lines are
    darker. `/camera/tracks/lost`: where lines should be that were lost in the last `LOST_FRAMES` frames, grey.
    `/camera/tails`: where bold lines were. `/camera/points`: points, once there are any, with their `point_id`.

    Once there is a right image: `/right/tracks` and `/right/tracks/rest`, the partners of these tracks, which look
    alike, `measured` being the partner; and with its calibration `/world/stereo`, the shown ones of known depth, m.

    Args:
        stream: where to log to.
        root: the entity above all these, in place of `/camera`.
        show_lost: draw lost lines for as long as they are looked for.
        tails: log tails.
        rest: log `rest` and `lost`.
        partners: log what the right image tells.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        root: str = "/camera",
        *,
        show_lost: bool = False,
        tails: bool = True,
        rest: bool = True,
        partners: bool = True,
    ) -> None:
        self._stream = stream
        self._root = root
        self._rest = rest
        self._show_lost = show_lost
        self._tails = Tails() if tails else None
        self._points = self._right = False
        self._partners = partners
        self._shown, self._bold = _Best(SHOWN_LINES), _Best(BOLD_LINES)

    def write(self, tracks: LineTracks, size: Size) -> None:
        """Log one frame's tracks; `size` is the image's width and height, px."""
        scale = picture_scale(size)
        confirmed = np.flatnonzero(tracks.confirmed)
        shown = confirmed[self._shown.rows(tracks, confirmed, size)]
        bold = self._bold.rows(tracks, shown, size)
        radii = np.full(len(shown), scale * THIN_RADIUS)
        radii[bold] = scale * BOLD_RADIUS
        self._right |= self._partners and len(tracks.right_hits) > 0
        self._log_seen("tracks", tracks, shown, radii)
        if self._right and tracks.segments_m is not None and tracks.depth_known is not None:
            known = shown[tracks.depth_known[shown]]
            log_lines_3d(self._stream, STEREO, tracks.segments_m[known], tracks.ids[known], 0.75)
        if self._rest:
            rest = np.delete(np.arange(len(tracks)), shown)
            self._log_seen("tracks/rest", tracks, rest, scale * THIN_RADIUS)
            recent = self._show_lost | (tracks.lost_frames <= LOST_FRAMES)
            ids, segments = tracks.lost_ids[recent], tracks.lost_segments_px[recent]
            grey = (track_colours(ids) * LOST_TONE + LOST_GREY * (1 - LOST_TONE)).astype(np.uint8)
            log_lines(self._stream, f"{self._root}/tracks/lost", segments, grey, scale * FAINT_RADIUS, ids)
        if self._tails is not None:
            ids, points, lengths = self._tails.add(tracks, tracks.ids[shown[bold]], scale * TAIL_LENGTH)
            dark = (TAIL_TONE * track_colours(ids)).astype(np.uint8)
            strips = _strips(strips_2d(points, lengths), dark, scale * THIN_RADIUS)
            self._stream.log(f"{self._root}/tails", strips)
        if self._points or len(tracks.point_ids):
            self._points = True
            colours = packed(track_colours(tracks.point_ids))
            dots = rr.Points2D(tracks.points_px + CORNER, colors=colours, radii=scale * POINT_RADIUS)
            self._stream.log(f"{self._root}/points", dots, rr.AnyValues(point_id=pa.array(tracks.point_ids)))

    def _log_seen(
        self, name: str, tracks: LineTracks, rows: NDArray[np.intp], radii: NDArray[np.float64] | float
    ) -> None:
        ids = tracks.ids[rows]
        colours = track_colours(ids)
        fragments = tracks.fragment_of[rows] >= 0
        colours[fragments] = (colours[fragments] * FRAGMENT_TONE).astype(np.uint8)
        entity, measured = f"{self._root}/{name}", tracks.measured[rows]
        log_lines(self._stream, entity, tracks.segments_px[rows], colours, radii, ids, measured=measured)
        if self._right:
            seen = np.isin(rows, np.flatnonzero(tracks.right_hits))
            entity, radii = f"{RIGHT}/{name}", np.broadcast_to(radii, len(rows))[seen]
            rows, colours, ids = rows[seen], colours[seen], ids[seen]
            measured = tracks.right_measured[rows]
            log_lines(self._stream, entity, tracks.right_px[rows], colours, radii, ids, measured=measured)


class _Best:
    """Which of a frame's tracks are the best `count`, steadily from frame to frame."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._taken = np.zeros(0, np.int64)

    def rows(self, tracks: LineTracks, among: NDArray[np.intp], size: Size) -> NDArray[np.intp]:
        """Places in `among`, which are rows of tracks."""
        chosen = np.arange(len(among))
        if len(among) > self._count:
            some = tracks.take(among)
            chosen = best(some, size, self._count, np.isin(some.ids, self._taken))
        self._taken = tracks.ids[among[chosen]]
        return chosen


class Tails:
    """Where lines came from in the last frames. One per stream of frames, fed in time order.

    A tail starts at its line's middle. How far a line moved along itself its ends alone tell, and one that only grows
    or shrinks has not moved at all: the end that moved less counts, and none where they disagree.
    """

    def __init__(self) -> None:
        self._added = 0
        self._ids = np.zeros(0, np.int64)
        self._bends = np.zeros((0, TAIL_FRAMES // TAIL_STEP, 2, 2), np.float32)  # lines, the oldest first

    def add(
        self, tracks: LineTracks, wanted: NDArray[np.int64], longest: float
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int_]]:
        """Take the next frame's tracks.

        Returns:
            (N,) those of the wanted ids that have a tail; (P, 2) float32 px, the points of all tails, none longer than
            `longest`, each from the present place to the oldest; (N,) how many of them each tail has.
        """
        ids = np.sort(np.concatenate([tracks.ids, tracks.lost_ids]))
        bends = np.full((len(ids), *self._bends.shape[1:]), np.nan, np.float32)
        before = np.searchsorted(self._ids, ids)
        now = np.flatnonzero(np.append(self._ids, -1)[before] == ids)
        bends[now] = self._bends[before[now]]
        here = np.searchsorted(ids, tracks.ids)
        rows = np.searchsorted(tracks.ids, wanted)
        rows = rows[~np.isnan(bends[here[rows], -1, 0, 0])]
        way = _way_back(tracks.segments_px[rows], bends[here[rows]], longest)
        points = (np.rint(way * 2) / 2).astype(np.float32)  # nobody sees half a pixel of a tail, and it compresses well
        if self._added % TAIL_STEP == 0:
            bends[:, :-1], bends[:, -1] = bends[:, 1:], np.nan
            bends[here, -1] = tracks.segments_px
        self._ids, self._bends, self._added = ids, bends, self._added + 1
        known = ~np.isnan(points[:, :, 0])
        return tracks.ids[rows], points[known], known.sum(axis=1)


def _way_back(lines: NDArray[np.float32], bends: NDArray[np.float32], longest: float) -> NDArray[np.float32]:
    """(N, K + 1, 2) places of the middles of (N, 2, 2) lines, then on their (N, K, 2, 2) earlier ones, the last first.

    NaN where there is no earlier line, and beyond the longest way.
    """
    way = [lines.mean(axis=1)]
    left = np.full((len(lines), 1), longest, np.float32)
    for k in reversed(range(bends.shape[1])):
        earlier = bends[:, k]
        along = earlier[:, 1] - earlier[:, 0]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
        shifts = ((earlier - lines) * along[:, None]).sum(axis=2)
        shift = np.where(shifts.prod(axis=1) > 0, np.sign(shifts[:, 0]) * np.abs(shifts).min(axis=1), 0)[:, None]
        across = earlier[:, 0] - way[-1]
        across -= (across * along).sum(axis=1, keepdims=True) * along
        step = across + shift * along
        length = np.linalg.norm(step, axis=1, keepdims=True)
        step *= np.where(left > 0, np.minimum(1, left / np.maximum(length, 1e-6)), np.nan)
        way.append(way[-1] + step)
        left, lines = left - length, earlier
    return np.stack(way, axis=1)


def picture_size(tracks: LineTracks, image: NDArray[np.generic] | None = None) -> Size:
    """Width and height of the image, px: of the camera's without one, or as the lines need without both."""
    if image is not None:
        return image.shape[1], image.shape[0]
    if tracks.camera is not None:
        return tracks.camera.width, tracks.camera.height
    right, down = np.ceil(tracks.segments_px.reshape(-1, 2).max(axis=0, initial=16)).astype(int).tolist()
    return right, down


def picture_scale(size: Size) -> float:
    """What widths of lines are multiples of."""
    return float(np.sqrt(size[0] * size[1]))


def log_lines(
    stream: rr.RecordingStream,
    entity: str,
    segments: NDArray[np.float32],
    colours: NDArray[np.uint8],
    radii: NDArray[np.float64] | float,
    ids: NDArray[np.int64] | None = None,
    **values: Any,
) -> None:
    """Log (N, 2, 2) lines, px, with (N, 3) or (1, 3) RGB, (N,) radii or one, px, (N,) ids of their tracks and more."""
    strips = _strips(strips_2d(segments), colours, radii)
    known = {} if ids is None else {"track_id": ids, **values}  # as Arrow's arrays, which have types when empty
    typed = {name: pa.array(column) for name, column in known.items()}
    stream.log(entity, strips, *([rr.AnyValues(**typed)] if typed else []))


def _strips(strips: pa.ListArray, colours: NDArray[np.uint8], radii: NDArray[np.float64] | float) -> rr.LineStrips2D:
    return rr.LineStrips2D(strips, colors=packed(colours), radii=radii)


def log_lines_3d(
    stream: rr.RecordingStream, entity: str, segments: NDArray[np.float32], ids: NDArray[np.int64], points: float
) -> None:
    """Log (N, 2, 3) lines in space in the colours of their tracks, with this radius in points of the screen."""
    lines = rr.LineStrips3D(strips_3d(segments), colors=packed(track_colours(ids)), radii=rr.Radius.ui_points(points))
    stream.log(entity, lines, rr.AnyValues(track_id=pa.array(ids)))


def pinhole(camera: CameraModel) -> rr.Pinhole:
    """The camera at `/camera`: only the intrinsics, as Rerun has no lens distortion."""
    return rr.Pinhole(
        focal_length=(camera.fx, camera.fy),
        principal_point=(camera.cx + float(CORNER), camera.cy + float(CORNER)),
        width=camera.width,
        height=camera.height,
        image_plane_distance=2 * camera.baseline_m or 0.5,  # before all lines of a pair
    )


class Space:
    """Logs poses of the camera, the way it came, and lines in space, at the stream's present time."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._before: NDArray[np.float32] | None = None
        self._moved = ["/camera"]
        self._latest: rr.Transform3D | None = None
        # upright where the world is the frame of a first camera held upright
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)

    def move(self, entity: str) -> None:
        """Move one more entity with the camera."""
        self._moved.append(entity)
        if self._latest is not None:
            self._stream.log(entity, self._latest)

    def log_pose(self, world_T_camera: NDArray[np.floating]) -> None:
        """Log a (4, 4) rigid motion; InputError where it is none."""
        pose = checked_pose(world_T_camera)
        place = pose[:3, 3].astype(np.float32)
        self._latest = rr.Transform3D(translation=place, mat3x3=pose[:3, :3])
        for entity in self._moved:
            self._stream.log(entity, self._latest)
        step = strips_3d(np.stack([place if self._before is None else self._before, place])[None])
        self._stream.log("/world/path", rr.LineStrips3D(step, colors=(255, 255, 255), radii=rr.Radius.ui_points(1)))
        self._before = place

    def log_lines(self, segments: NDArray[np.floating], ids: NDArray[np.int64]) -> None:
        """Log (N, 2, 3) lines in the colours of their tracks; InputError where they do not fit to N ids."""
        log_lines_3d(self._stream, "/world/lines", checked_lines(segments, ids), ids, 1.5)

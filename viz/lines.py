"""Lines as Rerun draws them: tracks, in the colours of their ids, whose state shows at a glance; lines in space."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from airline.errors import InputError
from frontend.camera.model import CameraModel
from frontend.colours import track_colours
from frontend.tracks import LineTracks
from viz.rerun_private import CORNER, packed, strips_2d, strips_3d

FRAGMENT_TONE = 0.55  # how dark a piece of a broken line is beside whole ones
LOST_TONE, LOST_GREY = 0.2, 120  # how much of its hue a lost line keeps, on which grey
CONFIRMED_RADIUS, TENTATIVE_RADIUS, LOST_RADIUS, TAIL_RADIUS = 1.5, 0.75, 0.4, 0.6  # points of the screen
LOST_FRAMES = 3  # lost lines are drawn for so many frames: where one should be is a guess, which soon is none
TAIL_FRAMES, TAIL_STEP = 12, 3
QUIET = (255, 196, 64)  # segments, which are not yet part of any track, RGB
TAIL_TONE = 0.75  # how dark a tail is beside its line


class Tails:
    """Where the lines' middles were in the last frames. One per stream of frames, fed in time order.

    A tail bends only at every `TAIL_STEP`-th frame, which hides tremble and compresses well.
    """

    def __init__(self) -> None:
        self._added = 0
        self._ids = np.zeros(0, np.int64)
        self._bends = np.zeros((0, TAIL_FRAMES // TAIL_STEP, 2), np.float32)

    def add(self, tracks: LineTracks) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.intp]]:
        """Take the next frame's tracks.

        Returns:
            (N,) rows of the confirmed tracks that have a tail; (P, 2) float32 px, the points of all tails, each from
            the oldest place to the present one; (N,) how many of them each tail has.
        """
        ids = np.sort(np.concatenate([tracks.ids, tracks.lost_ids]))
        bends = np.full((len(ids), *self._bends.shape[1:]), np.nan, np.float32)
        before = np.searchsorted(self._ids, ids)
        now = np.flatnonzero(np.append(self._ids, -1)[before] == ids)
        bends[now] = self._bends[before[now]]
        here, middles = np.searchsorted(ids, tracks.ids), tracks.segments_px.mean(axis=1)
        points = np.concatenate([bends[here], middles[:, None]], axis=1)
        if self._added % TAIL_STEP == 0:
            bends[:, :-1], bends[:, -1] = bends[:, 1:], np.nan
            bends[here, -1] = middles
        self._ids, self._bends, self._added = ids, bends, self._added + 1
        known = ~np.isnan(points[:, :, 0])
        rows = np.flatnonzero(tracks.confirmed & (known.sum(axis=1) > 1))
        return rows, points[rows][known[rows]], known[rows].sum(axis=1)


def log_tracks(
    stream: rr.RecordingStream, tracks: LineTracks, tails: Tails | None = None, *, show_lost: bool = False
) -> None:
    """Log one frame's tracks at the stream's present time.

    `/camera/tracks`: confirmed lines thick, tentative ones pale and thin, pieces of broken lines darker, each with its
    `track_id` and whether it was `measured` and not detected. `/camera/tracks/lost`: where lines should be that were
    lost in the last `LOST_FRAMES` frames, or with `show_lost` all that are looked for, grey. `/camera/tails`: where
    confirmed lines were; only with `tails`, those of this stream.
    """
    colours = track_colours(tracks.ids, tracks.confirmed)
    fragments = tracks.fragment_of >= 0
    colours[fragments] = (colours[fragments] * FRAGMENT_TONE).astype(np.uint8)
    radii = state_radii(tracks.confirmed)
    log_lines(stream, "/camera/tracks", tracks.segments_px, colours, radii, tracks.ids, measured=tracks.measured)
    shown = show_lost | (tracks.lost_frames <= LOST_FRAMES)
    lost = tracks.lost_ids[shown]
    grey = (track_colours(lost) * LOST_TONE + LOST_GREY * (1 - LOST_TONE)).astype(np.uint8)
    log_lines(stream, "/camera/tracks/lost", tracks.lost_segments_px[shown], grey, LOST_RADIUS, lost)
    if tails is not None:
        rows, points, lengths = tails.add(tracks)
        dark = (TAIL_TONE * track_colours(tracks.ids[rows])).astype(np.uint8)
        stream.log("/camera/tails", _strips(strips_2d(points, lengths), dark, TAIL_RADIUS))


def log_lines(
    stream: rr.RecordingStream,
    entity: str,
    segments: NDArray[np.float32],
    colours: NDArray[np.uint8],
    radii: NDArray[np.float64] | float,
    ids: NDArray[np.int64] | None = None,
    **values: Any,
) -> None:
    """Log (N, 2, 2) lines, px, with (N, 3) or (1, 3) RGB, (N,) radii or one, (N,) ids of their tracks and more."""
    strips = _strips(strips_2d(segments), colours, radii)
    stream.log(entity, *([strips] if ids is None else [strips, rr.AnyValues(track_id=ids, **values)]))


def state_radii(confirmed: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(N,) points of the screen: confirmed tracks are thicker than tentative ones."""
    return np.where(confirmed, CONFIRMED_RADIUS, TENTATIVE_RADIUS)


def _strips(strips: pa.ListArray, colours: NDArray[np.uint8], radii: NDArray[np.float64] | float) -> rr.LineStrips2D:
    return rr.LineStrips2D(strips, colors=packed(colours), radii=rr.Radius.ui_points(radii))


def pinhole(camera: CameraModel) -> rr.Pinhole:
    """The camera at `/camera`: only the intrinsics, as Rerun has no lens distortion."""
    return rr.Pinhole(
        focal_length=(camera.fx, camera.fy),
        principal_point=(camera.cx + float(CORNER), camera.cy + float(CORNER)),
        width=camera.width,
        height=camera.height,
        image_plane_distance=0.5,
    )


class Space:
    """Logs poses of the camera, the way it came, and lines in space, at the stream's present time."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._before: NDArray[np.float32] | None = None
        # upright where the world is the frame of a first camera held upright
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)

    def log_pose(self, world_T_camera: NDArray[np.floating]) -> None:
        """Log a (4, 4) rigid motion; InputError where it is none."""
        pose = np.asarray(world_T_camera, np.float64)
        rigid = pose.shape == (4, 4) and np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-3)
        if not rigid or not np.isfinite(pose).all():
            raise InputError("a pose must be a (4, 4) matrix of rotation and translation, from camera to world")
        place = pose[:3, 3].astype(np.float32)
        self._stream.log("/camera", rr.Transform3D(translation=place, mat3x3=pose[:3, :3]))
        step = strips_3d(np.stack([place if self._before is None else self._before, place])[None])
        self._stream.log("/world/path", rr.LineStrips3D(step, colors=(255, 255, 255), radii=rr.Radius.ui_points(1)))
        self._before = place

    def log_lines(self, segments: NDArray[np.floating], ids: NDArray[np.int64]) -> None:
        """Log (N, 2, 3) lines in the colours of their tracks; InputError where they do not fit to N ids."""
        lines = np.asarray(segments, np.float32)
        if lines.shape != (len(ids), 2, 3):
            raise InputError(f"lines in space must be (N, 2, 3) with N ids, not {lines.shape} with {len(ids)} ids")
        strips = rr.LineStrips3D(strips_3d(lines), colors=packed(track_colours(ids)), radii=rr.Radius.ui_points(1.5))
        self._stream.log("/world/lines", strips, rr.AnyValues(track_id=ids))

"""The tracker's result for one frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from frontend.camera.model import CameraModel


class TrackState(IntEnum):
    """Where a track is in its life."""

    TENTATIVE = 0
    CONFIRMED = 1


def _no_ids() -> NDArray[np.int64]:
    return np.zeros(0, np.int64)


def _no_segments() -> NDArray[np.float32]:
    return np.zeros((0, 2, 2), np.float32)


@dataclass(frozen=True)
class LineTracks:
    """The tracks that were seen in one frame. Row k of every (N, ...) array speaks of the same track.

    Attributes:
        frame_index: `Frame.index` of the frame.
        stamp_ns: sensor time, nanoseconds.
        ids: (N,) int64 track ids; never reused, ascending.
        segments_px: (N, 2, 2) float32 px, each track's line fused over the frames so far; the order of the end points
            is kept along a track.
        observed_px: (N, 2, 2) float32 px, the lines as detected in this frame, with the same order of end points.
        covariances: (N, 2, 2) float32 of the fused line's errors: its offset across itself at its middle (px) and its
            angle (radians).
        scores: (N,) float32 scores of the detections.
        descriptors: (N, C) float32 unit rows.
        states: (N,) uint8, values of `TrackState`.
        ages: (N,) int32 frames since the track began, 0 in its first frame.
        hits: (N,) int32 frames in which it was seen, this one included.
        line_indices: (N,) int32 row of the detection in the frame's `LineSet`.
        fragment_of: (N,) int64 id of the track whose line broke and left this piece, -1 for whole lines.
        lost_ids: (L,) int64 confirmed tracks that were not seen in this frame and are still looked for, ascending.
        lost_segments_px: (L, 2, 2) float32 px, where they should be.
        ended_ids: (E,) int64 tracks that ended with this frame and will never be seen again, ascending.
        camera: the camera, where known.
        reset: why all earlier tracks ended before this frame, or None.
    """

    frame_index: int
    stamp_ns: int
    ids: NDArray[np.int64]
    segments_px: NDArray[np.float32]
    observed_px: NDArray[np.float32]
    covariances: NDArray[np.float32]
    scores: NDArray[np.float32]
    descriptors: NDArray[np.float32]
    states: NDArray[np.uint8]
    ages: NDArray[np.int32]
    hits: NDArray[np.int32]
    line_indices: NDArray[np.int32]
    fragment_of: NDArray[np.int64]
    lost_ids: NDArray[np.int64] = field(default_factory=_no_ids)
    lost_segments_px: NDArray[np.float32] = field(default_factory=_no_segments)
    ended_ids: NDArray[np.int64] = field(default_factory=_no_ids)
    camera: CameraModel | None = None
    reset: str | None = None

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def confirmed(self) -> NDArray[np.bool_]:
        """(N,) mask of the tracks seen often enough to be trusted."""
        mask: NDArray[np.bool_] = self.states == TrackState.CONFIRMED
        return mask

    @cached_property
    def segments_normalized(self) -> NDArray[np.float32] | None:
        """(N, 2, 2) float32 undistorted coordinates of `segments_px` on the plane z = 1; None without a camera."""
        return None if self.camera is None else self.camera.normalize(self.segments_px)

"""The tracker's result for one frame."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from frontend.camera import CameraModel


class TrackState(IntEnum):
    """Where a track is in its life."""

    TENTATIVE = 0
    CONFIRMED = 1


@dataclass(frozen=True)
class LineTracks:
    """The tracks that were seen in one frame. Row k of every array speaks of the same track.

    Attributes:
        frame_index: `Frame.index` of the frame.
        stamp_ns: sensor time, nanoseconds.
        ids: (N,) int64 track ids; never reused, ascending.
        segments_px: (N, 2, 2) float32 px; the order of the end points is kept along a track.
        scores: (N,) float32 scores of the detections.
        descriptors: (N, C) float32 unit rows.
        states: (N,) uint8, values of `TrackState`.
        ages: (N,) int32 frames since the track began, 0 in its first frame.
        hits: (N,) int32 frames in which it was seen, this one included.
        line_indices: (N,) int32 row of the detection in the frame's `LineSet`.
        camera: the camera, where known.
        reset: why all earlier tracks ended before this frame, or None.
    """

    frame_index: int
    stamp_ns: int
    ids: NDArray[np.int64]
    segments_px: NDArray[np.float32]
    scores: NDArray[np.float32]
    descriptors: NDArray[np.float32]
    states: NDArray[np.uint8]
    ages: NDArray[np.int32]
    hits: NDArray[np.int32]
    line_indices: NDArray[np.int32]
    camera: CameraModel | None = None
    reset: str | None = None

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def confirmed(self) -> NDArray[np.bool_]:
        """(N,) mask of the tracks seen often enough to be trusted."""
        mask: NDArray[np.bool_] = self.states == TrackState.CONFIRMED
        return mask

    @property
    def segments_normalized(self) -> NDArray[np.float32] | None:
        """(N, 2, 2) float32 undistorted coordinates on the plane z = 1; None without a camera."""
        return None if self.camera is None else self.camera.normalize(self.segments_px)

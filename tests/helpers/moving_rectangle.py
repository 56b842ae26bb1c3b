"""Results as the pipeline would give them, for a drawn rectangle that moves over a plain background."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from airline.lines import LineSet
from airline.trace import Trace
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.protocols import FrameResult
from frontend.tracks import TrackState
from tests.helpers.made_tracks import blank_tracks

WIDTH, HEIGHT = 320, 240
STEP_NS = 33_333_333
CAMERA = CameraModel(WIDTH, HEIGHT, 300.0, 310.0, 159.5, 119.5)
RESET_FRAME = 6


def rectangle(frame: int) -> np.ndarray:
    """(4, 2, 2) float32 sides of the rectangle."""
    left, top = 40.25 + 3 * frame, 50.5 + 2 * frame
    corners = np.array([[left, top], [left + 120, top], [left + 120, top + 90], [left, top + 90]], np.float32)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def trace_of(segments: np.ndarray) -> Trace:
    """The trace of perfectly detected axis-parallel segments."""
    edges, horizontal = np.zeros((2, HEIGHT, WIDTH), np.uint8)
    for start, end in np.rint(segments).astype(int).tolist():
        cv2.line(edges, start, end, 255)
        if start[1] == end[1]:
            cv2.line(horizontal, start, end, 1)
    y, x = np.nonzero(edges)
    six = np.eye(6, dtype=np.float32)
    descriptors = six[np.where(horizontal[y, x], 0, 3)]
    pixels = np.stack([x, y], axis=1).astype(np.int32)
    n = len(segments)
    lines = LineSet(segments, np.ones(n, np.float32), six[[0, 3, 0, 3][:n]])
    labels = np.zeros(len(x), np.int32)
    return Trace(edges / np.float32(255), pixels, pixels.astype(np.float32), descriptors, labels, lines, {})


def frame_results(count: int, first_stamp_ns: int = 0, dtype: type = np.uint8) -> Iterator[FrameResult]:
    """`count` frames; tracks 0 to 3 are the sides, 0 and 1 are confirmed from the third frame on."""
    for k in range(count):
        segments = rectangle(k)
        image = np.full((HEIGHT, WIDTH, 3), 60, dtype)
        cv2.fillPoly(image, [np.rint(segments[:, 0]).astype(np.int32)], (150, 150, 150))
        stamp = first_stamp_ns + k * STEP_NS
        trace = trace_of(segments)
        tracks = blank_tracks(
            4,
            frame_index=k,
            stamp_ns=stamp,
            segments_px=segments,
            observed_px=segments,
            covariances=np.tile(np.diag([0.04, 1e-4]).astype(np.float32), (4, 1, 1)),
            scores=trace.lines.scores,
            descriptors=trace.lines.descriptors,
            states=np.where(np.arange(4) < 2, k >= 2, False).astype(np.uint8) * np.uint8(TrackState.CONFIRMED),
            ages=np.full(4, k, np.int32),
            hits=np.full(4, k + 1, np.int32),
            line_indices=np.arange(4, dtype=np.int32),
            camera=CAMERA,
            reset="the camera was covered" if k == RESET_FRAME else None,
        )
        yield FrameResult(Frame(k, stamp, image, CAMERA), trace, tracks, {"edges": 5.0 + k, "track": 0.5})

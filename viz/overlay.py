"""Tracks drawn into an image, without any viewer."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.tracks import LineTracks
from viz.colours import track_colours

SHIFT = 4  # fractional bits of OpenCV's sub-pixel coordinates


def draw_tracks(image: NDArray[np.uint8], tracks: LineTracks) -> NDArray[np.uint8]:
    """A copy of an image with its tracks, in the viewer's colours.

    Args:
        image: (H, W) grey or (H, W, 3) BGR uint8.
        tracks: what was seen in it; confirmed tracks are drawn last and thicker.

    Returns:
        (H, W, 3) uint8 BGR.
    """
    canvas = np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image.copy()
    colours = track_colours(tracks.ids, tracks.confirmed)[:, ::-1].tolist()
    points = np.rint(tracks.segments_px * (1 << SHIFT)).astype(int).tolist()
    for k in np.argsort(tracks.confirmed, kind="stable").tolist():
        start, end = points[k]
        cv2.line(canvas, start, end, colours[k], 2 if tracks.confirmed[k] else 1, cv2.LINE_AA, SHIFT)
    return canvas

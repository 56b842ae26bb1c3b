"""Lines drawn into an image with OpenCV, without any viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.colours import track_colours
from frontend.tracks import LineTracks

if TYPE_CHECKING:
    from viz.recording import RecordedFrame

SHIFT = 4  # fractional bits of OpenCV's sub-pixel coordinates
FAR = 1e6  # px; what lies farther out is no line in the picture
CONFIRMED, TENTATIVE = 2, 1  # line widths, px

Picture = NDArray[np.uint8]


def draw_tracks(image: Picture, tracks: LineTracks) -> Picture:
    """A copy of an image with its tracks, in the viewer's colours.

    Args:
        image: (H, W) grey or (H, W, 3) BGR uint8.
        tracks: what was seen in it; confirmed tracks are drawn last and thicker.

    Returns:
        (H, W, 3) uint8 BGR.
    """
    canvas = np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image.copy()
    colours = track_colours(tracks.ids, tracks.confirmed)
    for k in np.argsort(tracks.confirmed, kind="stable").tolist():
        _draw(canvas, tracks.segments_px[k], colours[k], CONFIRMED if tracks.confirmed[k] else TENTATIVE)
    return canvas


def draw_frame(frame: RecordedFrame) -> Picture:
    """A recorded frame's image with its lines, as they are coloured in the recording; two runs stand side by side.

    Returns:
        (H, W, 3) uint8 BGR; W is that of all panels together.
    """
    panels = []
    for layers in frame.panels:
        canvas = frame.image.copy()
        for strips in layers:
            below = canvas.copy()
            for k in np.argsort(strips.widths, kind="stable").tolist():
                _draw(canvas, strips.points[k], strips.colours[k, :3], int(strips.widths[k]))
            opacity = strips.colours[0, 3] / 255 if len(strips.colours) else 1.0  # one for all lines of a layer
            if opacity < 1:
                cv2.addWeighted(canvas, opacity, below, 1 - opacity, 0, dst=canvas)
        panels.append(canvas)
    return np.hstack(panels)


def _draw(canvas: Picture, points: NDArray[np.float32], rgb: NDArray[np.uint8], width: int) -> None:
    if not (np.abs(points) < FAR).all():  # NaN included
        return
    fixed = np.rint(points * (1 << SHIFT)).astype(np.int32)
    cv2.polylines(canvas, [fixed], False, rgb[::-1].tolist(), width, cv2.LINE_AA, SHIFT)

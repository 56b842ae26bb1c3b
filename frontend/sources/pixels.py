"""Pictures of a video as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from av.video.frame import VideoFrame
from av.video.reformatter import Interpolation, VideoReformatter

from frontend.sources.reading import Image

_TURNS = {90: 8, -90: 6, 180: 3, -180: 3}  # degrees counterclockwise to EXIF


def image_of(frame: VideoFrame, reformatter: VideoReformatter) -> Image:
    """(H, W) uint8 or uint16 of grey pictures, (H, W, 3) BGR uint8 of all others, C-contiguous."""
    name = frame.format.name
    if name.startswith("gray") and "f" not in name:
        target = "gray" if frame.format.components[0].bits == 8 else "gray16le"
    else:
        target = "bgr24"
    # the interpolation is that of chroma, for pixels like those of OpenCV
    made = reformatter.reformat(frame, format=target, interpolation=Interpolation.BICUBIC)
    plane: Any = made.planes[0]
    rows = np.frombuffer(plane, np.uint16 if target == "gray16le" else np.uint8).reshape(frame.height, -1)
    channels = 3 if target == "bgr24" else 1
    image: Any = np.ascontiguousarray(rows[:, : frame.width * channels])
    if made is frame and image.base is not None:  # the decoder's own memory
        image = image.copy()
    return image.reshape(frame.height, frame.width, 3) if channels == 3 else image  # type: ignore[no-any-return]


def orientation_of(frame: VideoFrame, jpeg: int) -> int:
    """How a picture is to be turned, as EXIF numbers it; `jpeg` is what a JPEG says of itself, else 1."""
    try:
        data: Any = frame.side_data.get("DISPLAYMATRIX")
    except ValueError:  # with data of a kind that PyAV does not know, such as EXIF, it tells the angle alone
        return jpeg if jpeg != 1 else _TURNS.get(frame.rotation, 1)
    if data is None:
        return 1
    across, down, to_across, to_down = np.frombuffer(bytes(data), np.int32)[[0, 1, 3, 4]].tolist()
    if abs(across) >= abs(down):
        return {(False, False): 1, (True, False): 2, (True, True): 3, (False, True): 4}[across < 0, to_down < 0]
    return {(False, False): 5, (False, True): 6, (True, True): 7, (True, False): 8}[down < 0, to_across < 0]

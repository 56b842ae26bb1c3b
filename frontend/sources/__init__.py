"""Sources of frames: one file per kind."""

from __future__ import annotations

import os

from airline.errors import InputError
from frontend.protocols import Source

__all__ = ["open_source"]


def open_source(
    spec: str | os.PathLike[str],
    *,
    fps: float = 30.0,
    reconnect_s: float = 60.0,
    calibrated: bool = True,
    autorotate: bool = True,
) -> Source:
    """Open whatever `spec` names. What exists on disk comes first, and its content decides, not its name.

    Args:
        spec: a video file, a folder of images or one image, a glob pattern, a camera's number or device, a URL of a
            stream or a recording, a named pipe, or "-" for a video on the standard input.
        fps: frames per second of images, and of raw video, without times.
        reconnect_s: for how long a network stream that drops is tried again, seconds; see `LiveSource`.
        calibrated: take the calibration that lies with a folder's images; see `FolderSource`.
        autorotate: turn pictures upright as their EXIF data or the video file says.

    Raises:
        InputError: it cannot be read.
        ConfigError: an argument that is impossible.
    """
    from pathlib import Path

    from frontend.sources import address, kinds
    from frontend.sources.folder import FolderSource
    from frontend.sources.image_names import IMAGE_SUFFIXES, is_pattern
    from frontend.sources.live import LiveSource

    text = kinds.local_name(spec)
    kind, suffix = kinds.kind_of(text), Path(text).suffix.lower()
    if kind == "missing" and text.isascii() and text.isdigit():
        return LiveSource(int(text[:9]))
    if kind == "camera":
        return LiveSource(text)
    if kind == "missing" and "://" in text:
        if address.length_of(text) is None:
            stream = LiveSource(text, reconnect_s)
            if not stream.is_recording:
                return stream
            stream.close()
    elif kind == "log" or (kind in ("missing", "unknown") and suffix in kinds.LOG_SUFFIXES):
        raise InputError(f"'{text}' is a log: open it with logs.open_images")
    elif (
        kind in ("folder", "image")
        or (kind in ("missing", "unknown") and suffix in IMAGE_SUFFIXES)
        or (kind == "missing" and is_pattern(text))
    ):
        return FolderSource(text, fps, calibrated=calibrated, autorotate=autorotate)
    from frontend.sources.video import VideoSource

    return VideoSource(text, autorotate=autorotate, fps=fps)

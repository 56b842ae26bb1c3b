"""Sources of frames: one file per kind."""

from __future__ import annotations

import os
from pathlib import Path

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
    """Open whatever `spec` names. What exists on disk comes first.

    Args:
        spec: a video file, a folder of images or one image, a glob pattern, a camera's number or a stream's URL.
        fps: frames per second of images without times.
        reconnect_s: for how long a network stream that drops is tried again, seconds; see `LiveSource`.
        calibrated: take the calibration that lies with a folder's images; see `FolderSource`.
        autorotate: turn pictures upright as their EXIF data or the video file says.

    Raises:
        InputError: it cannot be read.
        ConfigError: an argument that is impossible.
    """
    from frontend.sources.folder import FolderSource
    from frontend.sources.listing import IMAGE_SUFFIXES
    from frontend.sources.live import LiveSource
    from frontend.sources.video import VideoSource

    text = os.fspath(spec)
    exists, suffix = os.path.exists(text), Path(text).suffix.lower()  # noqa: PTH110  pathlib raises for long names
    if suffix in (".mcap", ".bag", ".db3"):
        raise InputError(f"'{text}' is a log: open it with logs.open_images")
    if not exists and text.isascii() and text.isdigit():
        return LiveSource(int(text[:9]))
    if not exists and "://" in text:
        return LiveSource(text, reconnect_s)
    if suffix in IMAGE_SUFFIXES or os.path.isdir(text) or (not exists and set("*?[") & set(text)):  # noqa: PTH112
        return FolderSource(text, fps, calibrated=calibrated, autorotate=autorotate)
    return VideoSource(text, autorotate=autorotate)

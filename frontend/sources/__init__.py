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
    start_s: float | None = None,
    end_s: float | None = None,
    reconnect_s: float = 60.0,
) -> Source:
    """Open whatever `spec` names. What exists on disk comes first.

    Args:
        spec: a video file, a folder of images or one image, a glob pattern, a camera's number or a stream's URL.
        fps: frames per second of images without times.
        start_s, end_s: seconds since the first frame; start is included, end is not.
        reconnect_s: for how long a network stream that drops is tried again, seconds; see `LiveSource`.

    Raises:
        InputError: it cannot be read.
        ConfigError: an argument that is impossible.
    """
    from frontend.sources.folder import IMAGE_SUFFIXES, FolderSource
    from frontend.sources.live import LiveSource
    from frontend.sources.video import VideoSource
    from frontend.sources.wrapped import SelectedFrames

    text = os.fspath(spec)
    exists, suffix = os.path.exists(text), Path(text).suffix.lower()  # noqa: PTH110  pathlib raises for long names
    source: Source
    if suffix in (".mcap", ".bag", ".db3"):
        raise InputError(f"'{text}' is a log: open it with logs.open_images")
    if not exists and text.isascii() and text.isdigit():
        source = LiveSource(int(text[:9]))
    elif not exists and "://" in text:
        source = LiveSource(text, reconnect_s)
    elif suffix in IMAGE_SUFFIXES or os.path.isdir(text) or (not exists and set("*?[") & set(text)):  # noqa: PTH112
        source = FolderSource(text, fps)
    else:
        source = VideoSource(text)
    return source if start_s is None and end_s is None else SelectedFrames(source, start_s=start_s, end_s=end_s)

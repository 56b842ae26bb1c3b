"""Sources of frames: one file per kind."""

from __future__ import annotations

import os
from pathlib import Path

from airline.errors import ConfigError, InputError
from frontend.protocols import Source
from frontend.sources.selection import select_frames

__all__ = ["open_source"]


def open_source(
    spec: str | os.PathLike[str],
    *,
    topic: str | None = None,
    fps: float = 30.0,
    start_s: float | None = None,
    end_s: float | None = None,
    reconnect_s: float = 60.0,
) -> Source:
    """Open whatever `spec` names. What exists on disk comes first.

    Args:
        spec: a video file, a folder of images or one image, a glob pattern, a camera's number or a stream's URL.
        topic: only logs have topics, and `logs.open_images` opens those.
        fps: frames per second of images without times.
        start_s, end_s: seconds since the first frame; start is included, end is not.
        reconnect_s: for how long a network stream that drops is tried again, seconds; see `LiveSource`.

    Raises:
        InputError: it cannot be read.
        ConfigError: an argument that is impossible, or does not fit this kind of source.
    """
    text = os.fspath(spec)
    if Path(text).suffix.lower() in (".mcap", ".bag", ".db3"):
        raise InputError(f"'{text}' is a log: open it with logs.open_images")
    if topic is not None:
        raise ConfigError(f"a topic is for logs, and '{text}' is not one: leave the topic out")
    source = _open(text, fps, reconnect_s)
    if start_s is None and end_s is None:
        return source
    return select_frames(source, start_s=start_s, end_s=end_s)


def _open(text: str, fps: float, reconnect_s: float) -> Source:
    from frontend.sources.folder import FolderSource
    from frontend.sources.layouts import IMAGE_SUFFIXES
    from frontend.sources.live import LiveSource
    from frontend.sources.video import VideoSource

    if not os.path.exists(text):  # noqa: PTH110  pathlib raises for a name that is too long
        if text.isascii() and text.isdigit():
            return LiveSource(int(text[:9]))
        if "://" in text:
            return LiveSource(text, reconnect_s)
        if any(character in text for character in "*?["):
            return FolderSource(text, fps)
    if Path(text).suffix.lower() in IMAGE_SUFFIXES or os.path.isdir(text):  # noqa: PTH112
        return FolderSource(text, fps)
    return VideoSource(text)

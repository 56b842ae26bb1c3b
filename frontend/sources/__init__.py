"""Sources of frames: one file per kind."""

from __future__ import annotations

import os
from typing import Any

from airline.errors import ConfigError, InputError
from frontend.protocols import Source

__all__ = ["open_source", "open_stereo"]


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


def open_stereo(
    left: str | os.PathLike[str] | Source,
    right: str | os.PathLike[str] | Source | None = None,
    *,
    rectified: bool = False,
    max_gap_s: float | None = None,
    **options: Any,
) -> Source:
    """Open two cameras as a source of rectified pairs; see `StereoSource`.

    Args:
        left: what `open_source` takes, or a source such as one of a log's topics; or without `right` the folder of a
            sequence of both.
        right: the same; None for the one that lies beside the left one, by name.
        rectified, max_gap_s: as of `StereoSource`.
        options: of `open_source`, for both.

    Raises:
        InputError: one of them cannot be read, or no second camera is found.
        ConfigError: an argument that is impossible.
    """
    from pathlib import Path

    from frontend.sources.pairs import find_pair
    from frontend.sources.stereo import StereoSource

    name = None
    if right is None:
        if isinstance(left, Source):
            raise ConfigError("a source alone shows no second camera: give the right one's, too")
        spec = os.fspath(left)
        left, right = find_pair(spec)
        name = Path(spec).resolve().name if Path(left).is_relative_to(spec) else None
    first = left if isinstance(left, Source) else open_source(left, **options)
    try:
        second = right if isinstance(right, Source) else open_source(right, **options)
    except BaseException:
        first.close()
        raise
    return StereoSource(first, second, rectified=rectified, max_gap_s=max_gap_s, name=name)

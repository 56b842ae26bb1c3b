"""Recordings in and out: logs with camera images are sources, files and streams of tracked lines are sinks."""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from logs.read import read_tracks
    from logs.sinks.foxglove import McapTrackSink
    from logs.sinks.tables import ParquetTrackSink
    from logs.sinks.zeromq import subscribe_tracks
    from logs.source import LogImageSource, McapImageSource
    from logs.stamps import TimeSource

__all__ = [
    "LogImageSource",
    "McapImageSource",
    "McapTrackSink",
    "ParquetTrackSink",
    "open_images",
    "read_tracks",
    "subscribe_tracks",
]

# Loaded on first use: OpenCV and the readers of all the formats take time to import.
_MODULES = {
    "LogImageSource": "logs.source",
    "McapImageSource": "logs.source",
    "McapTrackSink": "logs.sinks.foxglove",
    "ParquetTrackSink": "logs.sinks.tables",
    "read_tracks": "logs.read",
    "subscribe_tracks": "logs.sinks.zeromq",
}


def open_images(
    path: str | os.PathLike[str],
    topic: str | None = None,
    *,
    time_source: TimeSource = "header",
    autorotate: bool = True,
) -> LogImageSource:
    """The images of one topic of a log, MCAP, ROS 1 .bag or ROS 2 bag folder; see `LogImageSource`.

    Raises:
        InputError: no log that can be read, or no such topic.
    """
    from logs.files import open_log
    from logs.source import LogImageSource

    return LogImageSource(open_log(path), topic, time_source=time_source, autorotate=autorotate)


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'logs' has no attribute '{name}'")

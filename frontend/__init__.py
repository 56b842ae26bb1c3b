"""Streams, tracks lines in them, and hands the tracks on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from frontend.camera.model import CameraModel
    from frontend.frame import Frame
    from frontend.history import Observations, TrackHistory
    from frontend.pipeline import LineFrontend
    from frontend.protocols import FrameResult, Sink, Source
    from frontend.sources import open_source
    from frontend.tracker import LineTracker
    from frontend.tracking.config import TrackerConfig
    from frontend.tracks import LineTracks, TrackState

_HOMES = {
    "CameraModel": "frontend.camera.model",
    "Frame": "frontend.frame",
    "FrameResult": "frontend.protocols",
    "LineFrontend": "frontend.pipeline",
    "LineTracker": "frontend.tracker",
    "LineTracks": "frontend.tracks",
    "Observations": "frontend.history",
    "Sink": "frontend.protocols",
    "Source": "frontend.protocols",
    "TrackHistory": "frontend.history",
    "TrackState": "frontend.tracks",
    "TrackerConfig": "frontend.tracking.config",
    "open_source": "frontend.sources",
}

__all__ = [
    "CameraModel",
    "Frame",
    "FrameResult",
    "LineFrontend",
    "LineTracker",
    "LineTracks",
    "Observations",
    "Sink",
    "Source",
    "TrackHistory",
    "TrackState",
    "TrackerConfig",
    "open_source",
]


def __getattr__(name: str) -> Any:  # imports on first use, so that the command line answers at once
    if name not in _HOMES:
        raise AttributeError(f"module 'frontend' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)

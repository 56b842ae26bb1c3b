"""Streams, tracks lines in them, and hands the tracks on."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from frontend.camera.model import CameraModel
    from frontend.frame import Frame
    from frontend.history import Observations, TrackHistory
    from frontend.matching import LineMatches, match_lines
    from frontend.pipeline import LineFrontend
    from frontend.protocols import FrameResult, Sink, Source
    from frontend.sources import open_source, open_stereo
    from frontend.tracker import LineTracker
    from frontend.tracking.config import TrackerConfig
    from frontend.tracks import LineTracks, TrackState

__all__ = ["CameraModel", "Frame", "FrameResult", "LineFrontend", "LineMatches", "LineTracker", "LineTracks"]
__all__ += [
    "Observations",
    "Sink",
    "Source",
    "TrackHistory",
    "TrackState",
    "TrackerConfig",
    "match_lines",
    "open_source",
    "open_stereo",
]

_MODULES = {
    "camera.model": ("CameraModel",),
    "frame": ("Frame",),
    "history": ("Observations", "TrackHistory"),
    "matching": ("LineMatches", "match_lines"),
    "pipeline": ("LineFrontend",),
    "protocols": ("FrameResult", "Sink", "Source"),
    "sources": ("open_source", "open_stereo"),
    "tracker": ("LineTracker",),
    "tracking.config": ("TrackerConfig",),
    "tracks": ("LineTracks", "TrackState"),
}


def __getattr__(name: str) -> Any:  # imports on first use, so that the command line answers at once
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f"frontend.{module}"), name)
    raise AttributeError(f"module 'frontend' has no attribute '{name}'")

"""AirLine: a learned, edge-based line-segment detector."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from airline.config import DetectorConfig
    from airline.detector import AirLine
    from airline.errors import AirLineError, ConfigError, InputError, WeightsError
    from airline.lines import LineSet
    from airline.stages.edges import CannyEdges, EdgeDetector, ModuleEdges, UNetEdges
    from airline.trace import Trace

__version__ = "0.1.0"

_HOMES = {
    "AirLine": "airline.detector",
    "AirLineError": "airline.errors",
    "CannyEdges": "airline.stages.edges",
    "ConfigError": "airline.errors",
    "DetectorConfig": "airline.config",
    "EdgeDetector": "airline.stages.edges",
    "InputError": "airline.errors",
    "LineSet": "airline.lines",
    "ModuleEdges": "airline.stages.edges",
    "Trace": "airline.trace",
    "UNetEdges": "airline.stages.edges",
    "WeightsError": "airline.errors",
}

__all__ = [
    "AirLine",
    "AirLineError",
    "CannyEdges",
    "ConfigError",
    "DetectorConfig",
    "EdgeDetector",
    "InputError",
    "LineSet",
    "ModuleEdges",
    "Trace",
    "UNetEdges",
    "WeightsError",
]


def __getattr__(name: str) -> Any:  # imports on first use: torch and numba take seconds
    if name not in _HOMES:
        raise AttributeError(f"module 'airline' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)

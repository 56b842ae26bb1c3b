"""AirLine: a learned, edge-based line-segment detector."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from airline.config import DetectorConfig
    from airline.detector import AirLine
    from airline.edges import CannyEdges, EdgeDetector, ModuleEdges, UNetEdges
    from airline.errors import AirLineError, ConfigError, InputError, WeightsError
    from airline.lines import LineSet
    from airline.trace import Trace

__version__ = "0.1.0"

_HOMES = {
    "AirLine": "airline.detector",
    "AirLineError": "airline.errors",
    "CannyEdges": "airline.edges",
    "ConfigError": "airline.errors",
    "DetectorConfig": "airline.config",
    "EdgeDetector": "airline.edges",
    "InputError": "airline.errors",
    "LineSet": "airline.lines",
    "ModuleEdges": "airline.edges",
    "Trace": "airline.trace",
    "UNetEdges": "airline.edges",
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

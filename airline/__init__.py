"""AirLine: a learned, edge-based line-segment detector."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from airline.config import DetectorConfig as DetectorConfig
    from airline.detector import AirLine as AirLine
    from airline.errors import AirLineError as AirLineError
    from airline.errors import ConfigError as ConfigError
    from airline.errors import InputError as InputError
    from airline.errors import WeightsError as WeightsError
    from airline.lines import LineSet as LineSet
    from airline.stages.edges import CannyEdges as CannyEdges
    from airline.stages.edges import EdgeDetector as EdgeDetector
    from airline.stages.edges import ModuleEdges as ModuleEdges
    from airline.stages.edges import UNetEdges as UNetEdges
    from airline.trace import Trace as Trace

__version__ = "0.1.0"

_HOMES = {
    "config": ["DetectorConfig"],
    "detector": ["AirLine"],
    "errors": ["AirLineError", "ConfigError", "InputError", "WeightsError"],
    "lines": ["LineSet"],
    "stages.edges": ["CannyEdges", "EdgeDetector", "ModuleEdges", "UNetEdges"],
    "trace": ["Trace"],
}
__all__ = [name for names in _HOMES.values() for name in names]


def __getattr__(name: str) -> Any:  # imports on first use: torch and numba take seconds
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"airline.{home}"), name)
    raise AttributeError(f"module 'airline' has no attribute '{name}'")

"""Recordings in and out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from logs.mcap_source import McapSource

__all__ = ["McapSource"]


def __getattr__(name: str) -> Any:
    if name == "McapSource":  # on first use: OpenCV and the MCAP readers take time to import
        from logs.mcap_source import McapSource

        return McapSource
    raise AttributeError(f"module 'logs' has no attribute '{name}'")

"""Generated scenes with exact ground truth: images, visible lines, depth and poses.

Demonstrations, tests and training draw from it. Rendering is compiled on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from airline.scenes.effects import CameraEffects
    from airline.scenes.sequence import RenderedView, Sequence, render_sequence

__all__ = ["CameraEffects", "RenderedView", "Sequence", "render_sequence"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'airline.scenes' has no attribute '{name}'")
    from airline.scenes import effects, sequence

    return getattr(effects if name == "CameraEffects" else sequence, name)

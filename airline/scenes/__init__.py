"""Generated scenes with exact ground truth: images, visible lines, depth and poses.

Demonstrations, tests and training draw from it. Rendering is compiled on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from airline.scenes.clip import RenderedClip, RenderedView, render_clip
    from airline.scenes.effects import CameraEffects

__all__ = ["CameraEffects", "RenderedClip", "RenderedView", "render_clip"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'airline.scenes' has no attribute '{name}'")
    from airline.scenes import clip, effects

    return getattr(effects if name == "CameraEffects" else clip, name)

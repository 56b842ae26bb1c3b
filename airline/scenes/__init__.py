"""Generated scenes with exact ground truth: images, visible lines, depth and poses.

Demonstrations, tests and training draw from it. Rendering is compiled on first use.
"""

from airline.scenes.camera import CameraEffects
from airline.scenes.clip import RenderedClip, RenderedView, render_clip, render_pairs

__all__ = ["CameraEffects", "RenderedClip", "RenderedView", "render_clip", "render_pairs"]

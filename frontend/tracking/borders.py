"""Lines and the border of the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit


def clip(segments: NDArray[np.float32], size: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The parts of segments inside the image.

    Args:
        segments: (N, 2, 2) float32 px.
        size: (width, height), px.

    Returns:
        (N, 2, 2) float32 px, as they are where nothing is inside, and (N,) float32 the length inside, px.
    """
    clipped, lengths = segments.copy(), np.zeros(len(segments), np.float32)
    _clip(clipped, lengths, size[0], size[1])
    return clipped, lengths


@njit()
def _clip(segments, lengths, width, height):  # type: ignore[no-untyped-def]
    for n in range(len(segments)):
        x, y = np.float64(segments[n, 0, 0]), np.float64(segments[n, 0, 1])
        dx, dy = segments[n, 1, 0] - x, segments[n, 1, 1] - y
        length = np.hypot(dx, dy)
        if not length > 0:
            continue
        ux, uy = dx / length, dy / length
        low, high = inside(x, y, ux, uy, 0.0, length, width, height)
        if high > low:
            segments[n, 0, 0], segments[n, 0, 1] = x + low * ux, y + low * uy
            segments[n, 1, 0], segments[n, 1, 1] = x + high * ux, y + high * uy
            lengths[n] = high - low


@njit()
def inside(x, y, ux, uy, low, high, width, height):  # type: ignore[no-untyped-def]
    """The part of [low, high] along the line (x, y) + t (ux, uy) that lies in the image; empty if the last is less."""
    for start, step, limit in ((x, ux, width - 0.5), (y, uy, height - 0.5)):
        if abs(step) > 1e-9:
            a, b = (-0.5 - start) / step, (limit - start) / step
            low, high = max(low, min(a, b)), min(high, max(a, b))
        elif start < -0.5 or start > limit:
            return 0.0, -1.0
    return low, high

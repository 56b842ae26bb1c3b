"""Line strips as Rerun stores them, built from arrays: a list of arrays costs Rerun's own conversion milliseconds."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

CORNER = np.float32(0.5)  # Rerun puts (0, 0) at the corner of the top-left pixel, we put it at its centre


def strips_2d(points: NDArray[np.float32], lengths: NDArray[np.int_] | None = None) -> pa.ListArray:
    """Strips for `rr.LineStrips2D`, moved to Rerun's convention of pixels.

    Args:
        points: (N, 2, 2) float32 segments, px; or, with lengths, (sum of lengths, 2) points of all strips in a row.
        lengths: (N,) how many points each strip has.
    """
    offsets = np.arange(len(points) + 1) * 2 if lengths is None else np.concatenate([[0], np.cumsum(lengths)])
    return _lists(points + CORNER, offsets, rr.components.LineStrip2DBatch._ARROW_DATATYPE)


def strips_3d(segments: NDArray[np.float32]) -> pa.ListArray:
    """Strips for `rr.LineStrips3D` of (N, 2, 3) float32 segments."""
    return _lists(segments, np.arange(len(segments) + 1) * 2, rr.components.LineStrip3DBatch._ARROW_DATATYPE)


def _lists(points: NDArray[np.float32], offsets: NDArray[np.int_], kind: pa.DataType) -> pa.ListArray:
    values = pa.array(np.ascontiguousarray(points, np.float32).ravel())
    inner = pa.FixedSizeListArray.from_arrays(values, type=kind.value_type)
    return pa.ListArray.from_arrays(pa.array(offsets.astype(np.int32)), inner, type=kind)


def packed(rgb: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """(N,) uint32 colours as Rerun stores them, 0xRRGGBBAA, of (N, 3) uint8 RGB."""
    r, g, b = rgb.T.astype(np.uint32)
    colours: NDArray[np.uint32] = r << 24 | g << 16 | b << 8 | np.uint32(255)
    return colours

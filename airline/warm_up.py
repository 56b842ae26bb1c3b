"""Compiling a part of the detector by itself, so that another process can do so beside the one that detects."""

from __future__ import annotations

import numpy as np

from airline.stages.fit import TotalLeastSquaresFitter
from airline.stages.refine import ImageRefiner


def compile_last_steps() -> None:
    """Compile the second half of the line fit, on one made-up part (see `split_regions`), and the refinement."""
    count = 12
    x, y = np.arange(count) + 3.0, np.full(count, 4.0)
    sums = [np.sum(values) for values in (np.ones(count), x, y, x * x, x * y, y * y)]
    moments = np.array([[*sums, x[0], y[0], x[-1], y[-1]]])
    support, descriptors = np.ones((24, 24), np.float32), np.eye(6, dtype=np.float32)[np.zeros(count, int)]
    rows, bounds, merged = np.arange(count), np.array([[0, count]]), np.zeros(1, np.int64)
    lines, _ = TotalLeastSquaresFitter().choose(support, descriptors, rows, bounds, moments, merged)
    assert len(lines) == 1
    ImageRefiner().refine(lines, support.astype(np.uint8))

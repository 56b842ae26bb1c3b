"""Rendered scenes as training samples: clean images with exact lines, so that structure beats texture."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.scenes import Sequence
from airline.training.consensus import PIECE, PseudoLabels
from airline.training.dataset import Sample

FIRST_SEED = 1000  # scenes below are for tests, demonstrations and validation
FRAMES = 300


def render_sample(number: int) -> Sample:
    """One clean view of a scene of its own; every visible line has share 1."""
    rng = np.random.default_rng(number)
    kind = ("indoor", "street")[number % 2]
    sequence = Sequence(kind=kind, motion="slow", seed=FIRST_SEED + number, frames=FRAMES, effects=None)
    view = sequence.render(int(rng.integers(0, FRAMES)))
    pieces = cut(view.segments_px)
    gray: NDArray[np.uint8] = cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY)
    return Sample(gray, PseudoLabels(pieces, np.ones(len(pieces), np.float32)))


def render_samples(count: int, workers: int) -> list[Sample]:
    """Views of `count` different scenes, indoors and streets in turn."""
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(render_sample, range(count), chunksize=4))


def cut(segments: NDArray[np.float32]) -> NDArray[np.float32]:
    """(M, 2, 2) pieces of about `PIECE` px of (N, 2, 2) segments, px."""
    if not len(segments):
        return segments
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    counts = np.maximum(1, lengths / PIECE).astype(int)
    owner = np.repeat(np.arange(len(segments)), counts)
    order = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    start, delta = segments[owner, 0], (segments[owner, 1] - segments[owner, 0]) / counts[owner][:, None]
    low = start + order[:, None] * delta
    return np.stack([low, low + delta], axis=1).astype(np.float32)

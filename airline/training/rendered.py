"""Rendered scenes as training samples: clean images with exact lines, so that structure beats texture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.scenes import RenderedClip
from airline.training.consensus import PIECE, PseudoLabels
from airline.training.dataset import Sample
from airline.training.progress import in_parallel

FIRST_SEED = 1000  # of the scenes to train on; scenes below are for tests, demonstrations and validation
HELD_OUT_SEED = 900
FRAMES = 300


def render_sample(number: int, first_seed: int = FIRST_SEED) -> Sample:
    """One clean view of a scene of its own; every visible line has share 1."""
    rng = np.random.default_rng(number)
    kind = ("indoor", "street")[number % 2]
    sequence = RenderedClip(kind=kind, motion="slow", seed=first_seed + number, frames=FRAMES, effects=None)
    view = sequence.render(int(rng.integers(0, FRAMES)))
    pieces = cut(view.segments_px)
    gray: NDArray[np.uint8] = cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY)
    return Sample(gray, PseudoLabels(pieces, np.ones(len(pieces), np.float32)))


def render_samples(count: int, first_seed: int = FIRST_SEED) -> list[Sample]:
    """Views of `count` different scenes, indoors and streets in turn."""
    return in_parallel(lambda number: render_sample(number, first_seed), range(count), "scenes")


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

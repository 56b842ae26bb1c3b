"""Batches of augmented crops, made ahead of the network."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

from airline.network.unet import normalise
from airline.training.dataset import Sample, random_crop
from airline.training.loss import PixelWeights
from airline.training.schedule import Schedule

Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  # images, targets, weights


def make_batch(samples: list[Sample], schedule: Schedule, weigh: PixelWeights, seed: tuple[int, ...]) -> Batch:
    """One batch of augmented crops, a function of the seed alone.

    Returns:
        (B, 1, H, W) normalised float images, float soft edge maps, and the pixels' float weights.
    """
    rng = np.random.default_rng(seed)
    chosen = rng.integers(0, len(samples), schedule.batch)
    images, targets, inside = zip(*(random_crop(samples[i], schedule.crop, rng) for i in chosen), strict=True)
    return (
        normalise(torch.from_numpy(np.stack(images)[:, None]).float()),
        torch.from_numpy(np.stack(targets)[:, None]),
        torch.from_numpy(np.stack([weigh(*pair) for pair in zip(targets, inside, strict=True)])[:, None]),
    )


def batches(
    samples: list[Sample], schedule: Schedule, weigh: PixelWeights, seed: int, first: int, workers: int = 1
) -> Generator[Batch, None, None]:
    """Batches from step `first` on, without end; `workers` threads make them ahead, and their number changes nothing.

    Threads do: nearly all the time is spent in OpenCV, NumPy and compiled code that let other threads run.
    """
    with ThreadPoolExecutor(workers) as pool:
        ahead = deque(
            pool.submit(make_batch, samples, schedule, weigh, (seed, first + k)) for k in range(2 * workers + 1)
        )
        try:
            for step in itertools.count(first + len(ahead)):
                yield ahead.popleft().result()
                ahead.append(pool.submit(make_batch, samples, schedule, weigh, (seed, step)))
        finally:
            for batch in ahead:
                batch.cancel()

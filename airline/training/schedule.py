"""How long to train and how fast to learn."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Schedule:
    """A training of so many steps, or of so many minutes.

    Attributes:
        steps: number of steps; with it, what is learned depends on the seed alone.
        minutes: wall time instead; exactly one of the two is given.
        batch: crops per step.
        crop: side of a crop, px.
        peak_rate: highest learning rate.
        warmup: steps until it is reached.
    """

    steps: int | None = None
    minutes: float | None = None
    batch: int = 12
    crop: int = 256
    peak_rate: float = 2e-3
    warmup: int = 200

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.minutes is None):
            raise ValueError("give either steps or minutes")

    def done(self, step: int, seconds: float) -> float:
        """Share of the training that is behind us after `step` steps and `seconds`; 1 or more at its end."""
        if self.steps is not None:
            return step / self.steps
        assert self.minutes is not None
        return seconds / (60 * self.minutes)

    def rate(self, step: int, seconds: float) -> float:
        """Learning rate: a linear warm-up, then a cosine down to a hundredth of the peak."""
        if step < self.warmup:
            return self.peak_rate * (step + 1) / self.warmup
        if self.steps is not None:
            share = (step - self.warmup) / max(1, self.steps - self.warmup)
        else:
            share = min(1.0, self.done(step, seconds))
        return self.peak_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))

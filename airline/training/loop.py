"""The training loop, its loss, and how long it runs and how fast it learns."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field

import torch
from torch.nn import functional

from airline.errors import ConfigError
from airline.network.unet import UNet
from airline.training.crops import Crops


@dataclass(frozen=True)
class Schedule:
    """A training of so many steps, or of so many minutes.

    Attributes:
        steps: number of steps; with it, what is learned depends on the seed alone.
        minutes: wall time instead; exactly one of the two is given.
        peak_rate: highest learning rate.
        warmup: steps until it is reached.
    """

    steps: int | None = None
    minutes: float | None = None
    peak_rate: float = 2e-3
    warmup: int = 200

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


@dataclass
class State:
    """A training on its way.

    Attributes:
        net: the network, with batch normalisation.
        device: where it is trained.
        step, seconds: what is behind us.
        best: highest F-score of a validation so far, percent, at `best_step`.
    """

    net: UNet
    device: torch.device
    step: int = 0
    seconds: float = 0.0
    best: float = 0.0
    best_step: int = 0
    optimiser: torch.optim.Optimizer = field(init=False)

    def __post_init__(self) -> None:
        self.net.to(self.device).to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
        self.optimiser = torch.optim.AdamW(self.net.parameters(), weight_decay=1e-4)


def find_device(name: str) -> torch.device:
    """The device "cpu", "cuda" or "auto", which is CUDA where there is one; ConfigError where "cuda" is not there."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("no CUDA device is available: use --device cpu or auto")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def edge_loss(logits: torch.Tensor, target: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Weighted mean binary cross entropy with soft targets; all (B, 1, H, W), logits before the sigmoid."""
    total = functional.binary_cross_entropy_with_logits(logits.float(), target, weights, reduction="sum")
    return total / weights.sum()


def train(
    state: State, crops: Crops, schedule: Schedule, after_step: Callable[[float], bool] = lambda loss: False
) -> None:
    """Train from where `state` stands to the end of the schedule; ConfigError if the loss is no finite number any more.

    `after_step` is called with the loss after every step; True stops the training, ready to go on later.
    """
    net, optimiser, device = state.net, state.optimiser, state.device
    started = time.monotonic() - state.seconds
    # a GPU is faster than one thread makes crops; on a CPU the network wants the cores itself
    workers = min(16, os.cpu_count() or 1) if device.type == "cuda" else 1
    with closing(crops.ahead(state.step, workers)) as batches:
        while schedule.done(state.step, state.seconds) < 1:
            for group in optimiser.param_groups:
                group["lr"] = schedule.rate(state.step, state.seconds)
            image, target, weights = (part.to(device) for part in next(batches))
            with torch.autocast(device.type, torch.bfloat16):
                logits = net(image.contiguous(memory_format=torch.channels_last))
            loss = edge_loss(logits, target, weights)
            optimiser.zero_grad(set_to_none=True)
            torch.autograd.backward(loss)
            torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
            state.step += 1
            state.seconds = time.monotonic() - started
            value = loss.item()
            if not math.isfinite(value):
                raise ConfigError(f"the loss is {value} at step {state.step}: start again with another --seed")
            if after_step(value):
                break

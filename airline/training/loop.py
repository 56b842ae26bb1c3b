"""The training loop."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from typing import Literal

import torch

from airline.errors import ConfigError
from airline.network.unet import UNet
from airline.training.batches import batches
from airline.training.dataset import Sample
from airline.training.loss import PixelWeights, edge_loss
from airline.training.schedule import Schedule

Device = Literal["auto", "cpu", "cuda"]


@dataclass
class State:
    """A training on its way.

    Attributes:
        net: the network, with batch normalisation.
        device: where it is trained.
        step: number of steps behind us.
        seconds: wall time behind us.
        best: highest F-score of a validation so far, percent.
        best_step: when that was.
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


def find_device(name: Device) -> torch.device:
    """The device of a name; "auto" is CUDA where there is one.

    Raises:
        ConfigError: CUDA was asked for and there is none.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("no CUDA device is available: use --device cpu or auto")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def train(
    state: State,
    samples: list[Sample],
    schedule: Schedule,
    seed: int,
    weigh: PixelWeights,
    after_step: Callable[[float], bool] = lambda loss: False,
) -> None:
    """Train from where `state` stands to the end of the schedule.

    Args:
        state: changed in place.
        samples: what to draw crops from; those of a step depend on `seed` and its number alone.
        schedule: how long, and how fast.
        seed: of the crops.
        weigh: how much each pixel counts in the loss.
        after_step: called with the loss after every step; True stops the training, ready to go on later.

    Raises:
        ConfigError: the loss is no finite number any more.
    """
    net, optimiser, device = state.net, state.optimiser, state.device
    started = time.monotonic() - state.seconds
    # a GPU is faster than one thread makes crops; on a CPU the network wants the cores itself
    workers = min(16, os.cpu_count() or 1) if device.type == "cuda" else 1
    with closing(batches(samples, schedule, weigh, seed, state.step, workers)) as crops:
        while schedule.done(state.step, state.seconds) < 1:
            for group in optimiser.param_groups:
                group["lr"] = schedule.rate(state.step, state.seconds)
            image, target, weights = (part.to(device) for part in next(crops))
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

"""The training loop, its loss and schedule, and how good the network is meanwhile on samples held out."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from airline.detector import AirLine
from airline.errors import ConfigError, InputError
from airline.evaluation.metrics import PixelScores, mean, pixel_scores
from airline.lines import scale_points
from airline.network.runtimes import has_bf16
from airline.network.unet import UNet
from airline.stages.edges import UNetEdges
from airline.training.crops import Batch, Crops, draw_labels
from airline.training.dataset import Sample

MAX_HELD_OUT = 60
TRUSTED = 0.4  # share of views from which on a labelled piece counts as a line
SEED = 12345  # of the crops for the loss
BATCHES = 4  # of them
PANEL = (400, 400)  # px, largest width and height of one picture in a sheet


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
    short = device.type == "cuda" or has_bf16()  # imitated, it is eight times slower than float32
    with closing(crops.ahead(state.step, workers)) as batches:
        while schedule.done(state.step, state.seconds) < 1:
            for group in optimiser.param_groups:
                group["lr"] = schedule.rate(state.step, state.seconds)
            image, target, weights = (part.to(device) for part in next(batches))
            with torch.autocast(device.type, torch.bfloat16, enabled=short):
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


def split(samples: list[Sample]) -> tuple[list[Sample], list[Sample]]:
    """Samples held out, one in twenty and at most 60, and the others; a single one is in both."""
    count = min(MAX_HELD_OUT, max(1, len(samples) // 20))
    return samples[:count], samples[count:] or samples


class Validation:
    """Measures networks on the same held-out samples, always in the same way."""

    def __init__(self, kinds: Mapping[str, list[Sample]], crops: Crops) -> None:
        """Keep the samples by kind, and make the crops on which the loss is measured, as `crops` makes them."""
        self._kinds = {kind: samples for kind, samples in kinds.items() if samples}
        own = {kind: replace(crops, samples=samples, seed=SEED) for kind, samples in self._kinds.items()}
        self._crops = {kind: [each.at(step) for step in range(BATCHES)] for kind, each in own.items()}

    def measure(self, net: UNet, device: torch.device) -> dict[str, tuple[float, PixelScores]]:
        """By kind of sample: mean loss on fixed crops, and scores of the detector's lines against trusted labels."""
        (plain, detector), found = _ready(net, device), {}
        for kind, samples in self._kinds.items():
            scores = []
            for sample in samples:
                trusted = sample.pieces[sample.shares >= TRUSTED]
                scores.append(pixel_scores(detector(sample.gray).segments, trusted, trusted, sample.gray.shape))
            found[kind] = _mean_loss(plain, self._crops[kind], device), mean(scores)
        return found

    def write_sheet(self, net: UNet, device: torch.device, path: Path) -> None:
        """A picture of four samples, of the first kind but for one of each other; raises InputError."""
        first, *others = self._kinds.values()
        few = [*first[: 4 - len(others)], *(samples[0] for samples in others)]
        _, detector = _ready(net, device)
        if not cv2.imwrite(str(path), np.concatenate([_sheet_row(sample, detector) for sample in few])):
            raise InputError(f"cannot write {path}: make room, or give an --out elsewhere")


@torch.inference_mode()
def _mean_loss(net: UNet, crops: list[Batch], device: torch.device) -> float:
    losses = []
    for batch in crops:
        image, target, weights = (part.to(device) for part in batch)
        losses.append(edge_loss(net(image.contiguous(memory_format=torch.channels_last)), target, weights).item())
    return float(np.mean(losses))


def _sheet_row(sample: Sample, detector: AirLine) -> NDArray[np.uint8]:
    """One row of a sheet, BGR: the image, its labels, the edges found and the lines found."""
    trace, gray = detector.trace(sample.gray), sample.gray
    scale = min(side / length for side, length in zip(PANEL, gray.shape[::-1], strict=True))
    maps = draw_labels(sample.pieces, sample.shares, gray.shape), trace.edges
    pictures = gray, *((255 * each).astype(np.uint8) for each in maps), gray // 2
    *panels, dim = (_panel(picture, scale) for picture in pictures)
    for start, end in np.rint(scale_points(trace.lines.segments, scale) * 16).astype(int).tolist():
        cv2.line(dim, start, end, (80, 220, 255), 1, cv2.LINE_AA, 4)
    return np.concatenate([*panels, dim], axis=1)


def _panel(gray: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    """A grey image at the left of a BGR panel with a rim; all panels are equally wide."""
    width, height = (max(1, round(side * scale)) for side in gray.shape[::-1])
    panel = np.full((height + 4, PANEL[0] + 4, 3), 40, np.uint8)
    panel[:height, :width] = cv2.resize(gray, (width, height), interpolation=cv2.INTER_AREA)[:, :, None]
    return panel


def _ready(net: UNet, device: torch.device) -> tuple[UNet, AirLine]:
    """The network for inference, and a detector with it; `net` stays as it is."""
    training = net.training
    plain: UNet = net.folded().to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    net.train(training)  # folding looks at batch normalisation in evaluation mode
    return plain, AirLine(edges=UNetEdges(plain, "cuda" if device.type == "cuda" else "torch"))

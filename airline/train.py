"""Train the edge network on photographs without labels: `python -m airline.train --images DIR --out FILE`."""

from __future__ import annotations

import argparse
import logging
import math
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from airline.errors import AirLineError, InputError
from airline.training.dataset import Sample, list_images, load_samples, random_crop
from airline.training.loss import edge_loss
from airline.training.rendered import render_samples
from airline.unet import UNet, UNetSpec
from airline.weights import save_unet

log = logging.getLogger("airline.train")

Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


@dataclass(frozen=True)
class Schedule:
    """How long and how fast to train."""

    steps: int
    batch: int = 12
    crop: int = 256
    peak_rate: float = 2e-3
    warmup: int = 200

    def rate(self, step: int) -> float:
        """Learning rate: linear warm-up, then a cosine down to a hundredth of the peak."""
        if step < self.warmup:
            return self.peak_rate * (step + 1) / self.warmup
        share = (step - self.warmup) / max(1, self.steps - self.warmup)
        return self.peak_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))


def normalise(images: torch.Tensor) -> torch.Tensor:
    """Zero mean and unit variance per image; a flat image becomes zeros."""
    std, mean = torch.std_mean(images, dim=(1, 2, 3), keepdim=True, correction=0)
    return (images - mean) / std.clamp(min=1.0)


def make_batch(samples: list[Sample], schedule: Schedule, seed: tuple[int, ...]) -> Batch:
    """One batch of augmented crops, a function of the seed alone."""
    rng = np.random.default_rng(seed)
    chosen = rng.integers(0, len(samples), schedule.batch)
    images, targets, inside = zip(*(random_crop(samples[i], schedule.crop, rng) for i in chosen), strict=True)
    return (
        normalise(torch.from_numpy(np.stack(images)[:, None]).float()),
        torch.from_numpy(np.stack(targets)[:, None]),
        torch.from_numpy(np.stack(inside)[:, None]),
    )


def batches(samples: list[Sample], schedule: Schedule, seed: int, first: int) -> Iterator[Batch]:
    """Batches from step `first` on, made ahead in a thread."""
    with ThreadPoolExecutor(1) as pool:
        ahead = [pool.submit(make_batch, samples, schedule, (seed, step)) for step in range(first, first + 3)]
        for step in range(first, schedule.steps):
            yield ahead.pop(0).result()
            ahead.append(pool.submit(make_batch, samples, schedule, (seed, step + 3)))


def train(samples: list[Sample], net: UNet, schedule: Schedule, seed: int, checkpoint: Path | None = None) -> UNet:
    """Train in place and return the network; resumes from `checkpoint` when it exists."""
    net = net.to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    optimiser = torch.optim.AdamW(net.parameters(), lr=schedule.peak_rate, weight_decay=1e-4)
    first = _resume(net, optimiser, checkpoint)
    held_out, rest = samples[: max(1, len(samples) // 50)], samples[max(1, len(samples) // 50) :] or samples
    running, since = math.nan, time.monotonic()
    for step, batch in enumerate(batches(rest, schedule, seed, first), start=first):
        for group in optimiser.param_groups:
            group["lr"] = schedule.rate(step)
        image, target, inside = batch
        with torch.autocast("cpu", torch.bfloat16):
            logits = net(image.contiguous(memory_format=torch.channels_last))
        loss = edge_loss(logits, target, inside)
        optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        running = loss.item() if math.isnan(running) else 0.98 * running + 0.02 * loss.item()
        if (step + 1) % 250 == 0 or step + 1 == schedule.steps:
            held = validation_loss(net, held_out, schedule)
            speed = (step + 1 - first) / (time.monotonic() - since)
            log.info(
                "step %d/%d  loss %.4f  held out %.4f  %.1f steps/s", step + 1, schedule.steps, running, held, speed
            )
            _keep(net, optimiser, step + 1, checkpoint)
    return net


@torch.no_grad()
def validation_loss(net: UNet, samples: list[Sample], schedule: Schedule) -> float:
    """Mean loss over fixed crops of held-out photographs."""
    net.eval()
    total = 0.0
    for index in range(4):
        image, target, inside = make_batch(samples, schedule, (12345, index))
        total += edge_loss(net(image.contiguous(memory_format=torch.channels_last)), target, inside).item()
    net.train()
    return total / 4


def _keep(net: UNet, optimiser: torch.optim.Optimizer, step: int, checkpoint: Path | None) -> None:
    if checkpoint is None:
        return
    partial = checkpoint.with_name(checkpoint.name + ".partial")
    torch.save({"net": net.state_dict(), "optimiser": optimiser.state_dict(), "step": step}, partial)
    partial.replace(checkpoint)


def _resume(net: UNet, optimiser: torch.optim.Optimizer, checkpoint: Path | None) -> int:
    if checkpoint is None or not checkpoint.exists():
        return 0
    state = torch.load(checkpoint, weights_only=True)
    net.load_state_dict(state["net"])
    optimiser.load_state_dict(state["optimiser"])
    log.info("resuming at step %d of %s", state["step"], checkpoint)
    return int(state["step"])


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m airline.train", description=__doc__)
    parser.add_argument("--images", type=Path, required=True, help="folder of photographs; labels are not needed")
    parser.add_argument("--out", type=Path, required=True, help="weights file to write (.safetensors)")
    parser.add_argument("--steps", type=int, default=8000, help="training steps (default: %(default)s)")
    parser.add_argument("--views", type=int, default=7, help="random views per photograph for the labels")
    parser.add_argument("--scenes", type=int, default=0, help="add this many rendered scenes with exact lines")
    parser.add_argument("--limit", type=int, help="use at most this many photographs")
    parser.add_argument("--cache", type=Path, help="folder of cached labels (default: beside --out)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    cv2.setNumThreads(1)
    try:
        if options.steps < 1 or not options.out.parent.is_dir():
            raise InputError("--steps must be at least 1 and the folder of --out must exist")
        paths = list_images(options.images)
        np.random.default_rng(options.seed).shuffle(paths)
        cache = options.cache or options.out.with_name(options.out.stem + "-labels")
        photographs = load_samples(paths[: options.limit], options.views, cache, workers=2)
        if not photographs:
            raise InputError(f"none of the images in {options.images} can be read: give photographs of 64 px and more")
        samples = photographs + render_samples(options.scenes, workers=2)
        torch.manual_seed(options.seed)
        checkpoint = options.out.with_name(options.out.stem + ".checkpoint")
        net = train(samples, UNet(UNetSpec(), norm=True), Schedule(options.steps), options.seed, checkpoint)
        notes = {
            "images": str(len(photographs)),
            "scenes": str(options.scenes),
            "steps": str(options.steps),
            "seed": str(options.seed),
        }
        log.info("wrote %s  sha256 %s", options.out, save_unet(net, options.out, **notes))
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

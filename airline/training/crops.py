"""Batches of labelled crops, made ahead of the network; geometry and light are augmented on the fly."""

from __future__ import annotations

import itertools
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from kornia.filters import get_motion_kernel2d
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from airline.kernels.threads import map_ahead
from airline.network.unet import normalise
from airline.training.dataset import Sample

Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  # images, targets, weights
RIDGE_SIGMA = 0.8  # px; the profile of a label across its line
# How often a crop is seen in which light. More than half is bad, since what is hard to see is slow to learn.
LIGHTS = {"untouched": 0.1, "everyday": 0.25, "dark": 0.3, "bright": 0.15, "blurred": 0.2}


@dataclass(frozen=True)
class Crops:
    """Batches of augmented crops of samples; each is a function of the seed and the step alone.

    Attributes:
        samples: what to draw crops from.
        seed: of the crops.
        batch: crops per step.
        size: side of a crop, px.
        weight: w of `pixel_weights`.
        radius: r of `pixel_weights`, px.
    """

    samples: list[Sample]
    seed: int
    batch: int = 12
    size: int = 256
    weight: float = 0.8
    radius: int = 5

    def at(self, step: int) -> Batch:
        """(B, 1, H, W) normalised float images, float soft edge maps, and the pixels' float weights."""
        rng = np.random.default_rng((self.seed, step))
        chosen = rng.integers(0, len(self.samples), self.batch)
        images, targets, inside = zip(*(random_crop(self.samples[i], self.size, rng) for i in chosen), strict=True)
        weights = [pixel_weights(*pair, self.weight, self.radius) for pair in zip(targets, inside, strict=True)]
        image, target, weight = (torch.from_numpy(np.stack(part)[:, None]) for part in (images, targets, weights))
        return normalise(image.float()), target, weight

    def ahead(self, first: int, workers: int = 1) -> Generator[Batch, None, None]:
        """Batches from step `first` on, without end; threads make them ahead, and their number changes nothing."""
        return map_ahead(self.at, itertools.count(first), workers)


def random_crop(
    sample: Sample, size: int, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]:
    """A randomly turned, scaled, mirrored crop of a sample under random light.

    (size, size) each: uint8 image, float32 soft edge map, bool mask of the pixels that lie inside the photograph.
    """
    height, width = sample.gray.shape
    scale = float(np.exp(rng.uniform(np.log(0.7), np.log(1.5))))
    angle = float(rng.uniform(-np.pi, np.pi)) if rng.random() < 0.6 else float(rng.normal(0, 0.08))
    cos, sin = scale * np.cos(angle), scale * np.sin(angle)
    linear = np.array([[cos, -sin], [sin, cos]])
    linear[:, 0] *= rng.choice([-1, 1])
    margin = min(0.5 * size / scale, 0.5 * width, 0.5 * height) * 0.8
    focus = np.array([rng.uniform(margin, width - margin), rng.uniform(margin, height - margin)])
    affine = np.concatenate([linear, ((size - 1) / 2 - linear @ focus)[:, None]], axis=1)
    image = cv2.warpAffine(sample.gray, affine, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    inside = cv2.warpAffine(np.full(sample.gray.shape, 255, np.uint8), affine, (size, size)) > 254
    moved = (sample.pieces @ linear.T + affine[:, 2]).astype(np.float32)
    return random_light(np.asarray(image, np.uint8), rng), draw_labels(moved, sample.shares, (size, size)), inside


def random_light(image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A camera's bad days: gamma, contrast, motion blur, defocus, over-exposure, darkness and noise, in this order."""
    light = list(LIGHTS)[rng.choice(len(LIGHTS), p=tuple(LIGHTS.values()))]
    if light == "untouched":
        return image
    x: NDArray[Any] = image.astype(np.float32)
    if rng.random() < 0.5:
        x = 255 * (x / 255) ** np.float32(np.exp(rng.uniform(-0.6, 0.6)))
    if light == "blurred" or rng.random() < 0.05:
        length, degrees = 2 * int(rng.integers(2, 7)) + 1, float(rng.uniform(0, 180))
        x = cv2.filter2D(x, -1, get_motion_kernel2d(length, degrees, mode="bilinear")[0].numpy())
    elif rng.random() < 0.15:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.5, 1.5))
    noise = rng.uniform(0, 6) if rng.random() < 0.5 else 0.0
    if light == "everyday":
        x *= np.float32(np.exp(rng.uniform(np.log(0.3), 0)))
        x += np.float32(rng.uniform(0, 30))
    elif light == "dark":
        x *= np.float32(np.exp(rng.uniform(np.log(0.12), np.log(0.5))))
        noise = rng.uniform(2, 12)
    elif light == "bright":
        x *= np.float32(rng.uniform(1.3, 2.5))
    if noise:
        x += rng.standard_normal(x.shape, np.float32) * np.float32(noise)
    return np.asarray(np.clip(np.rint(x), 0, 255), np.uint8)


def draw_labels(
    pieces: NDArray[np.float32], shares: NDArray[np.float32], shape: tuple[int, int]
) -> NDArray[np.float32]:
    """(H, W) soft edge map: each piece is its share times a Gaussian profile; the maximum where pieces meet."""
    target = np.zeros(shape, np.float32)
    _draw(pieces, shares, target)
    return target


@njit()
def _draw(segments, shares, target):  # type: ignore[no-untyped-def]
    height, width = target.shape
    reach = 2.5
    for i in range(len(segments)):
        x0, y0, x1, y1 = segments[i, 0, 0], segments[i, 0, 1], segments[i, 1, 0], segments[i, 1, 1]
        dx, dy = x1 - x0, y1 - y0
        squared = dx * dx + dy * dy
        if squared < 1e-6:
            continue
        for y in range(max(0, int(min(y0, y1) - reach)), min(height, int(max(y0, y1) + reach) + 2)):
            for x in range(max(0, int(min(x0, x1) - reach)), min(width, int(max(x0, x1) + reach) + 2)):
                t = min(1.0, max(0.0, ((x - x0) * dx + (y - y0) * dy) / squared))
                ex, ey = x - x0 - t * dx, y - y0 - t * dy
                distance = ex * ex + ey * ey
                if distance < reach * reach:
                    value = shares[i] * np.exp(-distance / (2 * RIDGE_SIGMA * RIDGE_SIGMA))
                    target[y, x] = max(target[y, x], value)


def pixel_weights(
    target: NDArray[np.float32], inside: NDArray[np.bool_], weight: float, radius: int
) -> NDArray[np.float32]:
    """How much each pixel counts: `(1 - w) + w * dilate_r(Y > 0)` (equation 1 of the AirLine paper), outside nothing.

    Args:
        target: (H, W) soft edge map Y.
        inside: (H, W) the pixels of the photograph.
        weight: w in [0, 1].
        radius: r, px, of a disk.
    """
    near = cv2.dilate((target > 0.1).astype(np.uint8), disk(radius))
    return np.asarray(((1 - weight) + weight * near) * inside, np.float32)


def disk(radius: int) -> NDArray[np.uint8]:
    """(2r+1, 2r+1) mask of the offsets within `radius` px."""
    axis = np.arange(-radius, radius + 1)
    return ((axis[:, None] ** 2 + axis[None] ** 2) <= radius**2).astype(np.uint8)

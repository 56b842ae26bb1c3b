"""Labelled crops for training: pseudo-labels cached on disk, geometry and light augmented on the fly."""

from __future__ import annotations

import hashlib
import logging
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from airline.kernels.compiled import njit
from airline.training.consensus import PseudoLabels, consensus
from airline.training.progress import in_parallel

log = logging.getLogger(__name__)

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm"}
RIDGE_SIGMA = 0.8  # px; the profile of a label across its line
LABEL_VERSION = 2  # part of the cache key; raise it when the labels change
# How often a crop is seen in which light. More than half is bad, since what is hard to see is slow to learn.
LIGHTS = {"untouched": 0.1, "everyday": 0.25, "dark": 0.3, "bright": 0.15, "blurred": 0.2}


@dataclass(frozen=True)
class Sample:
    """A photograph with its labels."""

    gray: NDArray[np.uint8]
    labels: PseudoLabels


def list_images(folder: Path) -> list[Path]:
    """Image files directly in a folder, sorted by name.

    Raises:
        InputError: there are none.
    """
    found = sorted(p for p in folder.glob("*") if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file())
    if not found:
        raise InputError(f"no images in {folder}: give a folder of photographs (jpg, png, ...)")
    return found


def label_image(path: Path, views: int, cache: Path) -> Sample | None:
    """A photograph with its pseudo-labels, from the cache or computed now; None if it cannot be read."""
    data = path.read_bytes()
    gray = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if gray is None or min(gray.shape) < 64:
        return None
    digest = hashlib.sha256(data).hexdigest()
    stored = cache / f"{digest[:24]}-v{LABEL_VERSION}-{views}.npz"
    labels = _cached_labels(stored)
    if labels is not None:
        return Sample(gray, labels)
    labels = consensus(gray, views, np.random.default_rng(int(digest[:12], 16)))
    partial = stored.with_name(stored.stem + ".partial.npz")
    np.savez(partial, pieces=labels.pieces, shares=labels.shares)
    partial.replace(stored)
    return Sample(gray, labels)


def _cached_labels(stored: Path) -> PseudoLabels | None:
    try:
        with stored.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return PseudoLabels(arrays["pieces"], arrays["shares"])
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile):
        log.warning("%s is damaged: its labels are made anew", stored)
        return None


def load_samples(paths: list[Path], views: int, cache: Path) -> list[Sample]:
    """Label photographs in parallel; unreadable ones are left out with a warning."""
    cache.mkdir(parents=True, exist_ok=True)
    found = in_parallel(lambda path: label_image(path, views, cache), paths, "labels")
    samples = [sample for sample in found if sample is not None]
    if len(samples) < len(paths):
        log.warning("%d of %d images could not be read and were left out", len(paths) - len(samples), len(paths))
    return samples


def fingerprint(samples: list[Sample]) -> str:
    """What tells one set of samples from another: the start of a SHA-256 over all pixels and labels."""
    digest = hashlib.sha256()
    for sample in samples:
        for array in (sample.gray, sample.labels.pieces, sample.labels.shares):
            digest.update(repr(array.shape).encode())
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()[:12]


def draw_labels(segments: NDArray[np.float32], shares: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """(size, size) soft edge map: each piece is its share times a Gaussian profile; the maximum where pieces meet."""
    target = np.zeros((size, size), np.float32)
    _draw(segments, shares, target)
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
                    if value > target[y, x]:
                        target[y, x] = value


def random_crop(
    sample: Sample, size: int, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]:
    """A randomly turned, scaled, mirrored crop of a sample under random light.

    Returns:
        (size, size) uint8 image, (size, size) float32 soft edge map, (size, size) bool mask of the pixels that lie
        inside the photograph.
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
    moved = (sample.labels.pieces @ linear.T + affine[:, 2]).astype(np.float32)
    return random_light(image, rng), draw_labels(moved, sample.labels.shares, size), inside


def random_light(image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A camera's bad days: gamma, contrast, motion blur, defocus, over-exposure, darkness and noise, in this order."""
    light = list(LIGHTS)[rng.choice(len(LIGHTS), p=tuple(LIGHTS.values()))]
    if light == "untouched":
        return image
    x: NDArray[Any] = image.astype(np.float32)
    if rng.random() < 0.5:
        x = 255 * (x / 255) ** np.float32(np.exp(rng.uniform(-0.6, 0.6)))
    if light == "blurred" or rng.random() < 0.05:
        x = cv2.filter2D(x, -1, motion_kernel(int(rng.integers(4, 14)), rng.uniform(0, np.pi)))
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


def motion_kernel(length: int, angle: float) -> NDArray[np.float32]:
    """Normalised blur kernel of a straight motion of `length` px; symmetric, so that edges keep their place."""
    side = length | 1
    centre = (side - 1) / 2
    step = 0.5 * (length - 1) * np.array([np.cos(angle), np.sin(angle)])
    ends = np.rint((centre + np.stack([-step, step])) * 16).astype(int)
    kernel = np.zeros((side, side), np.uint8)
    cv2.line(kernel, ends[0].tolist(), ends[1].tolist(), 255, 1, cv2.LINE_AA, 4)
    weights = kernel.astype(np.float32) + kernel[::-1, ::-1]
    kernel_of_one: NDArray[np.float32] = weights / weights.sum()
    return kernel_of_one

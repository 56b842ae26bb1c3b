"""Training samples: photographs with lines that a person drew, or with cached pseudo-labels; rendered scenes."""

from __future__ import annotations

import hashlib
import logging
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.command import track
from airline.scenes import RenderedClip
from airline.training.consensus import PIECE, consensus
from airline.training.drawn import Drawn

log = logging.getLogger(__name__)

Item = TypeVar("Item")
Result = TypeVar("Result")

LABEL_VERSION = 2  # part of the cache key; raise it when the labels change
FIRST_SEED = 1000  # of the scenes to train on; scenes below are for tests, demonstrations and validation
HELD_OUT_SEED = 900
FRAMES = 300  # of a scene's clip, of which one is rendered


@dataclass(frozen=True)
class Sample:
    """An image with its labels.

    Attributes:
        gray: (H, W) uint8.
        pieces: (N, 2, 2) float32 px, short pieces of lines.
        shares: (N,) float32 in [0, 1], the share of the views that saw the piece; 1 where lines are known.
    """

    gray: NDArray[np.uint8]
    pieces: NDArray[np.float32]
    shares: NDArray[np.float32]


def load_samples(paths: list[Path], views: int, cache: Path) -> list[Sample]:
    """Photographs with pseudo-labels; unreadable ones are left out with a warning."""
    cache.mkdir(parents=True, exist_ok=True)
    return _readable(lambda path: label_image(path, views, cache), paths, "labels")


def load_drawn(drawn: Mapping[Path, Drawn]) -> list[Sample]:
    """Photographs with drawn lines; unreadable ones are left out with a warning. InputError where lines do not fit."""
    return _readable(lambda path: draw_image(path, drawn[path]), list(drawn), "drawn lines")


def _readable(label: Callable[[Path], Sample | None], paths: list[Path], title: str) -> list[Sample]:
    found = _in_parallel(label, paths, title)
    samples = [sample for sample in found if sample is not None]
    if len(samples) < len(paths):
        log.warning("%d of %d images could not be read and were left out", len(paths) - len(samples), len(paths))
    return samples


def label_image(path: Path, views: int, cache: Path) -> Sample | None:
    """A photograph with its pseudo-labels, from the cache or computed now; None if it cannot be read."""
    data = path.read_bytes()
    gray = _decode(data)
    if gray is None:
        return None
    digest = hashlib.sha256(data).hexdigest()
    stored = cache / f"{digest[:24]}-v{LABEL_VERSION}-{views}.npz"
    try:
        with stored.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return Sample(gray, arrays["pieces"], arrays["shares"])
    except FileNotFoundError:
        pass
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile):
        log.warning("%s is damaged: its labels are made anew", stored)
    pieces, shares = consensus(gray, views, np.random.default_rng(int(digest[:12], 16)))
    partial = stored.with_name(stored.stem + ".partial.npz")
    np.savez(partial, pieces=pieces, shares=shares)
    partial.replace(stored)
    return Sample(gray, pieces, shares)


def draw_image(path: Path, drawn: Drawn) -> Sample | None:
    """A photograph with drawn lines, each of share 1; None if it cannot be read, InputError where they do not fit."""
    gray = _decode(path.read_bytes())
    if gray is None:
        return None
    drawn.check(gray.shape[1], gray.shape[0])
    pieces = cut(drawn.segments)
    return Sample(gray, pieces, np.ones(len(pieces), np.float32))


def _decode(data: bytes) -> NDArray[np.uint8] | None:
    gray = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    return None if gray is None or min(gray.shape) < 64 else np.asarray(gray, np.uint8)


def render_samples(count: int, first_seed: int = FIRST_SEED) -> list[Sample]:
    """Views of `count` different scenes, indoors and streets in turn."""
    return _in_parallel(lambda number: render_sample(number, first_seed), range(count), "scenes")


def render_sample(number: int, first_seed: int = FIRST_SEED) -> Sample:
    """One clean view of a scene of its own; every visible line has share 1."""
    rng, kind = np.random.default_rng(number), ("indoor", "street")[number % 2]
    clip = RenderedClip(kind=kind, motion="slow", seed=first_seed + number, frames=FRAMES, effects=None)
    view = clip.render(int(rng.integers(0, FRAMES)))
    pieces = cut(view.segments_px)
    gray = np.asarray(cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY), np.uint8)
    return Sample(gray, pieces, np.ones(len(pieces), np.float32))


def cut(segments: NDArray[np.float32]) -> NDArray[np.float32]:
    """(M, 2, 2) pieces of about `PIECE` px of (N, 2, 2) segments, px."""
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    counts = np.maximum(1, lengths / PIECE).astype(int)
    owner = np.repeat(np.arange(len(segments)), counts)
    order = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    start, delta = segments[owner, 0], (segments[owner, 1] - segments[owner, 0]) / counts[owner][:, None]
    low = start + order[:, None] * delta
    return np.stack([low, low + delta], axis=1).astype(np.float32)


def fingerprint(samples: list[Sample]) -> str:
    """What tells one set of samples from another: the start of a SHA-256 over all pixels and labels."""
    digest = hashlib.sha256()
    for sample in samples:
        for array in (sample.gray, sample.pieces, sample.shares):
            digest.update(repr(array.shape).encode())
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()[:12]


def _in_parallel(work: Callable[[Item], Result], items: Sequence[Item], title: str) -> list[Result]:
    """Results in the order of the items; no processes, since a forked OpenCV can hang, and the work drops the GIL."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(track(pool.map(work, items), title, len(items)))

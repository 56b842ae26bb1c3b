"""What is measured of a detector, and of OpenCV's LSD beside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.evaluation.dataset import Sample, read_lines
from airline.evaluation.light import BAD_LIGHT
from airline.evaluation.metrics import RADII, PixelScores, mean, pixel_scores
from airline.evaluation.repeatability import PairScores, compare, random_view

VIEWS = 3  # per image

Image = NDArray[np.uint8]
Lines = NDArray[np.floating]
Detect = Callable[[Image], Lines]  # (H, W) grey image to (N, 2, 2) px
Figures = dict[str, Any]  # as the command's JSON has them


@dataclass
class Tally:
    """Everything measured of one detector, image by image."""

    scores: list[PixelScores] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)
    pairs: list[PairScores] = field(default_factory=list)
    bad_light: dict[str, list[PixelScores]] = field(default_factory=lambda: {light: [] for light in BAD_LIGHT})

    def add(self, segments: Lines, sample: Sample, shape: tuple[int, int]) -> None:
        """Score the lines of one image."""
        self.lines.append(len(segments))
        self.scores.append(pixel_scores(segments, sample.sparse, sample.dense, shape))

    def time(self, detect: Callable[..., Lines], sample: Sample, *inputs: NDArray[Any]) -> Lines:
        """Run a detector on inputs of which the first is the sample's image, and score and time it."""
        if not self.ms:  # compilation and first allocations are not what is timed
            detect(*inputs)
        started = time.perf_counter()
        segments = detect(*inputs)
        self.ms.append(1e3 * (time.perf_counter() - started))
        self.add(segments, sample, inputs[0].shape)
        return segments

    def figures(self) -> Figures:
        """Means over the images (of the times: the median); times and views only where there are any."""
        scores = mean(self.scores)
        figures: Figures = {
            "lp": {str(radius): round(value, 3) for radius, value in zip(RADII, scores.lp, strict=True)},
            **_precision_recall(scores),
            "f1": round(scores.f1, 3),
            "lines": round(float(np.mean(self.lines)), 2),
        }
        if self.pairs:
            errors = [pair.localisation for pair in self.pairs if not np.isnan(pair.localisation)]
            figures["repeatability"] = round(float(np.mean([pair.repeatability for pair in self.pairs])), 4)
            figures["localisation"] = round(float(np.mean(errors)), 4) if errors else None
        if self.ms:
            figures["ms"] = round(float(np.median(self.ms)), 3)
        return figures


def measure(samples: Iterable[Sample], ours: Detect) -> Figures:
    """All figures of a detector, with LSD's in the same run: the two take turns on every image.

    Views and noise are drawn from the position of the image in the data set, so they are the same in every run.

    Raises:
        InputError: an image cannot be read.
    """
    detectors = {"ours": ours, "lsd": lsd()}
    tallies = {name: Tally() for name in (*detectors, "lsd_prepared")}
    for index, sample in enumerate(samples):
        image = sample.read()
        for name, detect in detectors.items():
            segments = tallies[name].time(detect, sample, image)
            rng = np.random.default_rng(index)
            for _ in range(VIEWS):
                view, homography = random_view(rng, image)
                tallies[name].pairs.append(compare(segments, detect(view), homography, image.shape))
        for light, bad in BAD_LIGHT.items():
            poor = bad.degrade(image, index)
            found = {name: detect(poor) for name, detect in detectors.items()}
            found["lsd_prepared"] = detectors["lsd"](bad.prepare(poor))
            for name, segments in found.items():
                scores = pixel_scores(segments, sample.sparse, sample.dense, image.shape)
                tallies[name].bad_light[light].append(scores)
    figures = {**tallies["ours"].figures(), "lsd": tallies["lsd"].figures(), "bad_light": {}}
    for light in BAD_LIGHT:
        rivals = {name: _precision_recall(mean(tally.bad_light[light])) for name, tally in tallies.items()}
        figures["bad_light"][light] = {**rivals.pop("ours"), **rivals}
    return figures


def measure_files(samples: Iterable[Sample], folder: Path) -> Figures:
    """Scores of lines that another detector wrote as text files, one per image, in the format of `read_lines`.

    Raises:
        InputError: a file is missing or malformed, or an image cannot be read.
    """
    tally = Tally()
    for sample in samples:
        tally.add(read_lines(folder / f"{sample.path.stem}.txt"), sample, sample.read().shape)
    return tally.figures()


def lsd() -> Detect:
    """OpenCV's LSD (Grompone von Gioi et al. 2010) as people run it: default settings, coordinates as they come."""
    detector = cv2.createLineSegmentDetector()
    return lambda image: as_lines(detector.detect(image)[0])


def as_lines(found: NDArray[Any] | None) -> Lines:
    """(N, 2, 2) of what OpenCV's detectors return."""
    return np.zeros((0, 2, 2)) if found is None else np.asarray(found, np.float64).reshape(-1, 2, 2)


def _precision_recall(scores: PixelScores) -> Figures:
    return {key: round(getattr(scores, key), 3) for key in ("p2", "r2", "f2")}

"""What is measured of a detector, in good and in bad light, and of OpenCV's LSD beside it."""

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
from airline.evaluation.metrics import RADII, PairScores, PixelScores, compare, mean, pixel_scores, random_view

VIEWS = 3  # per image

Image = NDArray[np.uint8]
Lines = NDArray[np.floating]
Detect = Callable[[Image], Lines]  # (H, W) grey image to (N, 2, 2) px
Figures = dict[str, Any]  # as the command's JSON has them


@dataclass(frozen=True)
class BadLight:
    """A degradation, and the preparation that helps LSD most against it.

    Attributes:
        degrade: of a (H, W) image and a seed.
        sigma: of the preparation's Gaussian blur, px.
        amount: of its sharpening (unsharp mask); -1 blurs.
        gain: by which it stretches the grey levels.
    """

    degrade: Callable[[Image, int], Image]
    sigma: float
    amount: float
    gain: float

    def prepare(self, image: Image) -> Image:
        """`gain * (image + amount * (image - blurred))`, (H, W), rounded and clipped."""
        levels = image.astype(np.float32)
        detail = levels - cv2.GaussianBlur(levels, (0, 0), self.sigma)
        return _to_image(self.gain * (levels + self.amount * detail))


def darken(image: Image, seed: int) -> Image:
    """A quarter of the light, then Gaussian noise with a standard deviation of 8 grey levels."""
    return _to_image(0.25 * image + np.random.default_rng(seed).normal(0, 8, image.shape))


def motion_blur(image: Image, seed: int) -> Image:
    """Mean over 9 px along the rows; the seed is not used."""
    return np.asarray(cv2.blur(image, (9, 1)), np.uint8)


def overexpose(image: Image, seed: int) -> Image:
    """Twice the light, clipped; the seed is not used."""
    return _to_image(2.0 * image)


def _to_image(levels: NDArray[np.floating]) -> Image:
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)


# The preparations had the best F2 of LSD on the very images that are scored (YorkUrban's training half), over grids of
# blurs, sharpenings and gains: the rival is as strong as simple processing makes it. Our detector is not tuned there.
BAD_LIGHT = {
    "dark": BadLight(darken, sigma=1.25, amount=-1, gain=4),
    "blur": BadLight(motion_blur, sigma=2, amount=0.5, gain=1),
    "bright": BadLight(overexpose, sigma=1.5, amount=1, gain=0.6),
}


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
    """All figures of a detector, with LSD's in the same run: the two take turns on every image; raises InputError.

    Views and noise are drawn from the position of the image in the data set, so they are the same in every run.
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
    """Scores of lines that another detector wrote as text files, one per image, see `read_lines`; raises InputError."""
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

"""The detector with one part exchanged at a time, and what each exchange costs or gains."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.config import DetectorConfig, EdgeConfig, FitConfig, GrowConfig, OrientationConfig, RefineConfig, preset
from airline.detector import AirLine
from airline.evaluation.benchmark import Figures, Image, Lines, Tally, lsd
from airline.evaluation.dataset import Sample
from airline.stages.edges import CannyEdges, EdgeDetector, UNetEdges
from airline.stages.pixels import PixelSelector

BackEnd = Callable[[Image, NDArray[np.float32]], Lines]  # (H, W) grey image and edge map to (N, 2, 2) px

DEFAULT = DetectorConfig()
WITH_MEAN = OrientationConfig(subtract_mean=False)
TWO_KERNELS = OrientationConfig(channels=2, subtract_mean=False)  # less their mean, two channels know two values alone
GRADIENT = OrientationConfig(kind="gradient")


@dataclass(frozen=True)
class Variant:
    """A row of the table: settings, and the edges ("unet", "fast", "canny" or "sensitive canny") that they work on."""

    name: str
    config: DetectorConfig = DEFAULT
    edges: str = "unet"


VARIANTS = [
    Variant("default"),
    Variant("6 kernels, T 0.3", DetectorConfig(grow=GrowConfig(similarity=0.3))),
    Variant("6 kernels, mean, T 0.994", DetectorConfig(orientation=WITH_MEAN, grow=GrowConfig(similarity=0.994))),
    Variant("2 kernels, mean, T 0.995", DetectorConfig(orientation=TWO_KERNELS, grow=GrowConfig(similarity=0.995))),
    Variant(
        "image gradient, T 0.8",
        DetectorConfig(orientation=GRADIENT, grow=GrowConfig(similarity=0.8)),
    ),
    Variant("paper's line fit", DetectorConfig(fit=FitConfig(kind="paper"))),
    Variant(
        "bare least squares",
        DetectorConfig(fit=FitConfig(min_length=0, max_deviation=1000, max_gap=0, max_reach=0, min_score=0)),
    ),
    Variant("no joining", DetectorConfig(fit=FitConfig(max_gap=0))),
    Variant("no end-point reach", DetectorConfig(fit=FitConfig(max_reach=0))),
    Variant("no refinement", DetectorConfig(refine=RefineConfig(max_shift=0))),
    Variant("no least score", DetectorConfig(fit=FitConfig(min_score=0))),
    Variant("no thinning", DetectorConfig(edges=EdgeConfig(thin=False))),
    Variant("fast network", edges="fast"),
    Variant("Canny", edges="canny"),
    Variant("sensitive Canny", edges="sensitive canny"),
    Variant("paper preset", preset("paper")),
]


@dataclass(frozen=True)
class HoughTransform:
    """OpenCV's probabilistic Hough transform (Matas et al. 2000) on edge pixels, in cells of 1 px and 1 degree.

    Attributes:
        pixels: picks the edge pixels.
        votes: a line needs this many.
        min_length: shorter lines are dropped, px.
        max_gap: consecutive pixels of a line are at most this far apart, px.
    """

    pixels: PixelSelector
    votes: int = 20
    min_length: float = 10.0
    max_gap: float = 8.0

    def __call__(self, image: Image, edges: NDArray[np.float32]) -> Lines:
        """(N, 2, 2) lines, px, of an (H, W) edge map; the image is not looked at."""
        x, y = self.pixels.select(edges).pixels.T
        mask = np.zeros(edges.shape, np.uint8)
        mask[y, x] = 1
        lines = cv2.HoughLinesP(mask, 1, np.pi / 180, self.votes, None, self.min_length, self.max_gap)
        return np.zeros((0, 2, 2)) if lines is None else np.asarray(lines, np.float64).reshape(-1, 2, 2)


def measure_variants(samples: Iterable[Sample]) -> dict[str, Figures]:
    """Figures per row of the table; all rows share the edge maps of an image.

    Raises:
        InputError: an image cannot be read.
    """
    edges = edge_detectors()
    rows = {variant.name: (variant.edges, back_end(variant.config, edges[variant.edges])) for variant in VARIANTS}
    find = lsd()
    rows["Hough transform"] = "unet", HoughTransform(AirLine(edges=edges["unet"]).pixels)
    rows["LSD"] = "unet", lambda image, _: find(image)
    tallies = {name: Tally() for name in rows}
    for index, sample in enumerate(samples):
        image = sample.read()
        maps = {name: detector.detect(image) for name, detector in edges.items()}
        turn = index % len(rows)  # nobody is always the first after the edge network, which leaves caches cold
        for name, (source, detect) in [*rows.items()][turn:] + [*rows.items()][:turn]:
            if index == 0:  # compilation and first allocations are not what is timed
                detect(image, maps[source])
            started = time.perf_counter()
            segments = detect(image, maps[source])
            tallies[name].ms.append(1e3 * (time.perf_counter() - started))
            tallies[name].add(segments, sample, image.shape)
    return {name: tally.figures() for name, tally in tallies.items()}


def edge_detectors() -> dict[str, EdgeDetector]:
    """The edge detectors that the variants name."""
    return {
        "unet": UNetEdges(),
        "fast": UNetEdges("fast"),
        "canny": CannyEdges(),
        "sensitive canny": CannyEdges(30, 90, 0.7),
    }


def back_end(config: DetectorConfig, edges: EdgeDetector) -> BackEnd:
    """The stages after edge detection; `edges` only completes the detector and is not run."""
    detector = AirLine(config=config, edges=edges)
    return lambda image, edge_map: detector.trace_edges(edge_map, image).lines.segments

"""The detector with one part exchanged at a time, and what each exchange costs or gains."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.config import DetectorConfig, EdgeConfig, FitConfig, GrowConfig, OrientationConfig, RefineConfig, preset
from airline.detector import AirLine
from airline.evaluation.benchmark import Figures, Image, Lines, Tally, as_lines, lsd
from airline.evaluation.dataset import Sample
from airline.stages.edges import CannyEdges, EdgeDetector, UNetEdges
from airline.stages.pixels import PixelSelector

LEGEND = """\
Every row is the default with what the row names exchanged, in good light.
LPr, P2, R2, F2: see --help. No score minds several lines on one edge, so read them beside lines, the
  number of lines per image. ms: median time of the stages after the edge map; for LSD, of everything.
T: similarity at which a pixel joins a region, 0.6 in the default; rows that name it compare
  descriptors, each at its best T on every second image of YorkUrban's training half. Mean: the mean
  over the channels is not taken away.
Bare least squares: no cutting of bent regions, joining, end-point reach or minimum length.
Canny: thresholds 50 and 150, sigma 1 px; sensitive Canny: 30 and 90, 0.7 px. Hough transform:
  OpenCV's probabilistic one. Both the best F2 of several settings on every fourth image."""

BackEnd = Callable[[Image, NDArray[np.float32]], Lines]  # (H, W) grey image and edge map to (N, 2, 2) px

VARIANTS = {
    "default": DetectorConfig(),
    "6 kernels, T 0.3": DetectorConfig(grow=GrowConfig(similarity=0.3)),
    "6 kernels, mean, T 0.994": DetectorConfig(
        orientation=OrientationConfig(subtract_mean=False), grow=GrowConfig(similarity=0.994)
    ),
    "2 kernels, mean, T 0.995": DetectorConfig(  # less their mean, two channels know two values alone
        orientation=OrientationConfig(channels=2, subtract_mean=False), grow=GrowConfig(similarity=0.995)
    ),
    "image gradient, T 0.8": DetectorConfig(
        orientation=OrientationConfig(kind="gradient"), grow=GrowConfig(similarity=0.8)
    ),
    "paper's line fit": DetectorConfig(fit=FitConfig(kind="paper")),
    "bare least squares": DetectorConfig(
        fit=FitConfig(min_length=0, max_deviation=1000, max_gap=0, max_reach=0, min_score=0)
    ),
    "no joining": DetectorConfig(fit=FitConfig(max_gap=0)),
    "no end-point reach": DetectorConfig(fit=FitConfig(max_reach=0)),
    "no refinement": DetectorConfig(refine=RefineConfig(max_shift=0)),
    "no least score": DetectorConfig(fit=FitConfig(min_score=0)),
    "no thinning": DetectorConfig(edges=EdgeConfig(thin=False)),
    "fast network": DetectorConfig(),
    "Canny": DetectorConfig(),
    "sensitive Canny": DetectorConfig(),
    "paper preset": preset("paper"),
}


def edge_detectors() -> dict[str, EdgeDetector]:
    """By the variants that have edges of their own; the others work on those of "default"."""
    return {
        "default": UNetEdges(),
        "fast network": UNetEdges("fast"),
        "Canny": CannyEdges(),
        "sensitive Canny": CannyEdges(30, 90, 0.7),
    }


def measure_variants(samples: Iterable[Sample]) -> dict[str, Figures]:
    """Figures per row of the table; all rows share the edge maps of an image. Raises InputError."""
    edges, find = edge_detectors(), lsd()
    rows = {name: back_end(config, edges.get(name, edges["default"])) for name, config in VARIANTS.items()}
    rows["Hough transform"] = hough_transform(AirLine(edges=edges["default"]).pixels)
    rows["LSD"] = lambda image, _: find(image)
    tallies = {name: Tally() for name in rows}
    for index, sample in enumerate(samples):
        image = sample.read()
        maps = {name: detector.detect(image) for name, detector in edges.items()}
        turn = index % len(rows)  # nobody is always the first after the edge network, which leaves caches cold
        for name, detect in [*rows.items()][turn:] + [*rows.items()][:turn]:
            tallies[name].time(detect, sample, image, maps.get(name, maps["default"]))
    return {name: tally.figures() for name, tally in tallies.items()}


def back_end(config: DetectorConfig, edges: EdgeDetector) -> BackEnd:
    """The stages after edge detection; `edges` only completes the detector and is not run."""
    detector = AirLine(config=config, edges=edges)
    return lambda image, edge_map: detector.trace_edges(edge_map, image).lines.segments


def hough_transform(pixels: PixelSelector) -> BackEnd:
    """OpenCV's probabilistic Hough transform (Matas et al. 2000) on edge pixels, in cells of 1 px and 1 degree."""

    def detect(image: Image, edges: NDArray[np.float32]) -> Lines:
        x, y = pixels.select(edges).pixels.T
        mask = np.zeros(edges.shape, np.uint8)
        mask[y, x] = 1
        return as_lines(cv2.HoughLinesP(mask, 1, np.pi / 180, 20, None, minLineLength=10, maxLineGap=8))

    return detect

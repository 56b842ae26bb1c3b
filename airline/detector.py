"""The detector: edges, orientation, region grow, line fit, refinement."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airline.config import DetectorConfig, Runtime
from airline.config import preset as settings_of
from airline.image import Gray, to_gray
from airline.kernels.threads import Team, cores
from airline.lines import LineSet
from airline.stages.edges import CannyEdges, EdgeDetector, UNetEdges
from airline.stages.fit import LineFitter, PaperFitter, TotalLeastSquaresFitter
from airline.stages.grow import RegionGrower
from airline.stages.orientation import GradientOrientation, LineKernelOrientation, OrientationDetector
from airline.stages.pixels import PixelSelector, RidgePixels, ThresholdPixels
from airline.stages.refine import ImageRefiner
from airline.trace import Trace


class AirLine:
    """Line-segment detector after Lin and Wang, "AirLine: Efficient Learnable Line Detection with Local Edge Voting".

    Every stage is an attribute and may be replaced by an object with the same method:
    `edges` (`EdgeDetector`), `pixels` (`PixelSelector`), `orientation` (`OrientationDetector`), `grower`
    (`RegionGrower`), `fitter` (`LineFitter`), `refiner` (`ImageRefiner`).

    Example:
        >>> import numpy as np
        >>> from airline import AirLine
        >>> image = np.zeros((120, 160), np.uint8)
        >>> image[40:80, 50:110] = 200
        >>> len(AirLine()(image)) >= 4
        True
    """

    edges: EdgeDetector
    pixels: PixelSelector
    orientation: OrientationDetector
    grower: RegionGrower
    fitter: LineFitter
    refiner: ImageRefiner

    def __init__(
        self,
        preset: str = "default",
        *,
        config: DetectorConfig | None = None,
        edges: EdgeDetector | None = None,
        runtime: Runtime = "auto",
        threads: int | None = None,
    ) -> None:
        """Build the detector.

        Args:
            preset: "default", "fast", "accurate" or "paper".
            config: all settings; replaces the preset.
            edges: an edge detector of your own; replaces the one of the settings.
            runtime: what the U-Net runs in: "auto", "native", "openvino", "torch", "cuda": see `open_network`.
            threads: how many cores the U-Net (but for torch and CUDA) and the stages after it take; all by default, as
                is best for one image at a time.

        Raises:
            ConfigError: a setting is unknown or out of range, or the runtime is not here.
            WeightsError: the weights cannot be used.
        """
        settings = settings_of(preset) if config is None else config
        self.edges = edges if edges is not None else _edges(settings, runtime, threads)
        self._threads = cores() if threads is None else threads
        team = Team(self._threads)
        self.pixels, self.orientation, self.grower, self.fitter = _back_end(settings, self.edges, team)
        self.refiner = ImageRefiner(settings.refine.max_shift, team)

    def __call__(self, image: ArrayLike) -> LineSet:
        """Line segments of an image.

        Args:
            image: (H, W) grey, (H, W, 3) BGR or (H, W, 4) BGRA; uint8 or uint16; any size.

        Raises:
            InputError: the array is no such image.
        """
        return self.trace(image).lines

    def detect_batch(self, images: Iterable[ArrayLike]) -> Iterator[LineSet]:
        """Line segments of many images, in order, for work that is not live.

        The edge detector takes one image after the other in a thread of its own; the other stages work on one image for
        every two cores at once. Images are taken as they are needed; they may differ in size.

        Args:
            images: each as for calling.

        Raises:
            InputError: an array is no image; the results before it have come out.
        """

        def edges_of(image: ArrayLike) -> tuple[Gray, NDArray[np.float32]]:
            gray = to_gray(image)
            return gray, self.edges.detect(gray)

        def lines_of(future: Future[tuple[Gray, NDArray[np.float32]]]) -> LineSet:
            gray, edges = future.result()
            return self.trace_edges(edges, gray).lines

        at_once = max(1, self._threads // 2)
        under_way: deque[Future[LineSet]] = deque()
        with ThreadPoolExecutor(1, "edges") as ahead, ThreadPoolExecutor(at_once, "lines") as behind:
            try:
                for image in images:
                    under_way.append(behind.submit(lines_of, ahead.submit(edges_of, image)))
                    if len(under_way) > at_once:
                        yield under_way.popleft().result()
                while under_way:
                    yield under_way.popleft().result()
            finally:
                behind.shutdown(wait=False, cancel_futures=True)
                ahead.shutdown(wait=False, cancel_futures=True)

    def trace(self, image: ArrayLike) -> Trace:
        """Line segments of an image with every intermediate result; same arguments and errors as calling."""
        gray, edges, edges_ms = self.detect_edges(image)
        return self.trace_edges(edges, gray, edges_ms)

    def detect_edges(self, image: ArrayLike) -> tuple[Gray, NDArray[np.float32], float]:
        """The grey image, its (H, W) edge map, and the milliseconds that the edge detector took."""
        gray = to_gray(image)
        started = time.perf_counter()
        edges = self.edges.detect(gray)
        return gray, edges, 1e3 * (time.perf_counter() - started)

    def trace_edges(self, edges: NDArray[np.float32], gray: Gray | None = None, edges_ms: float = 0.0) -> Trace:
        """The stages after edge detection, on an edge map of your own.

        Args:
            edges: (H, W) float32 edge probability in [0, 1].
            gray: (H, W) the image; without it lines stay where the edge map has them.
            edges_ms: milliseconds to report for the edge stage.
        """
        edges = np.ascontiguousarray(edges, np.float32)
        clock = [time.perf_counter()]
        selected = self.pixels.select(edges)
        clock.append(time.perf_counter())
        image = gray if gray is not None else (255 * edges).astype(np.uint8)
        descriptors = self.orientation.describe(selected.support, image, selected.pixels)
        clock.append(time.perf_counter())
        regions = self.grower.grow(selected, descriptors)
        clock.append(time.perf_counter())
        lines, labels = self.fitter.fit(selected, descriptors, regions)
        clock.append(time.perf_counter())
        if gray is not None:
            lines = self.refiner.refine(lines, gray)
        clock.append(time.perf_counter())
        stages = ("pixels", "orientation", "grow", "fit", "refine")
        spent = dict(zip(stages, (1e3 * np.diff(clock)).tolist(), strict=True))
        return Trace(
            edges, selected.pixels, selected.positions, descriptors, labels, lines, {"edges": edges_ms, **spent}
        )


def _edges(config: DetectorConfig, runtime: Runtime, threads: int | None) -> EdgeDetector:
    return CannyEdges() if config.edges.detector == "canny" else UNetEdges(config.edges.weights, runtime, threads)


def _back_end(
    config: DetectorConfig, detector: EdgeDetector, team: Team
) -> tuple[PixelSelector, OrientationDetector, RegionGrower, LineFitter]:
    edges, orientation, grow, fit = config.edges, config.orientation, config.grow, config.fit
    smoothing = (1 if isinstance(detector, UNetEdges) else 3) if edges.smoothing == "auto" else edges.smoothing
    return (
        RidgePixels(edges.threshold, smoothing, team) if edges.thin else ThresholdPixels(edges.threshold),
        GradientOrientation()
        if orientation.kind == "gradient"
        else LineKernelOrientation(orientation.channels, orientation.kernel_size, orientation.subtract_mean, team),
        RegionGrower(grow.similarity, grow.min_pixels, edges.seed_threshold),
        PaperFitter()
        if fit.kind == "paper"
        else TotalLeastSquaresFitter(
            fit.min_length,
            fit.max_deviation,
            fit.max_gap,
            fit.max_offset,
            fit.max_angle,
            fit.max_reach,
            fit.min_score,
            team,
        ),
    )

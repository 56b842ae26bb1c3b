"""The detector: edges, orientation, region grow, line fit, refinement."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import ParamSpec, TypeVar

import numpy as np
from msgspec.structs import replace
from numpy.typing import ArrayLike, NDArray

from airline.config import DetectorConfig, Runtime
from airline.config import preset as settings_of
from airline.image import Gray, to_gray
from airline.kernels.threads import ThreadTeam, cores
from airline.lines import LineSet
from airline.stages.edges import CannyEdges, EdgeDetector, UNetEdges
from airline.stages.fit import LineFitter, PaperFitter, TotalLeastSquaresFitter
from airline.stages.grow import Grower, RegionGrower
from airline.stages.orientation import GradientOrientation, LineKernelOrientation, OrientationDetector
from airline.stages.pixels import PixelSelector, RidgePixels, ThresholdPixels
from airline.stages.refine import ImageRefiner, Refiner
from airline.trace import Trace

P = ParamSpec("P")
T = TypeVar("T")


class AirLine:
    """Line-segment detector after Lin and Wang, "AirLine: Efficient Learnable Line Detection with Local Edge Voting".

    Every stage is an attribute and may be replaced by an object with the same method.

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
    grower: Grower
    fitter: LineFitter
    refiner: Refiner

    def __init__(
        self,
        preset: str = "default",
        *,
        config: DetectorConfig | None = None,
        edges: EdgeDetector | None = None,
        runtime: Runtime = "auto",
        threads: int | None = None,
    ) -> None:
        """Build the detector; raises ConfigError and WeightsError.

        Args:
            preset: "default", "fast", "accurate" or "paper".
            config: all settings; replaces the preset.
            edges: an edge detector of your own; replaces the one of the settings.
            runtime: what the U-Net runs in: "auto", "native", "openvino", "torch", "cuda": see `open_network`.
            threads: how many cores the U-Net (but for torch and CUDA) and the stages after it take; all by default, as
                is best for one image at a time.
        """
        config = settings_of(preset) if config is None else config
        selection = config.edges
        if edges is None:
            canny = selection.detector == "canny"
            edges = CannyEdges() if canny else UNetEdges(selection.weights, runtime, threads)
        if isinstance(edges, UNetEdges) and selection.smoothing == "auto":
            selection = replace(selection, smoothing=1)
        self._threads = cores() if threads is None else threads
        team = ThreadTeam(self._threads)
        self.edges = edges
        self.pixels = RidgePixels(selection, team) if selection.thin else ThresholdPixels(selection)
        gradient = config.orientation.kind == "gradient"
        self.orientation = GradientOrientation() if gradient else LineKernelOrientation(config.orientation, team)
        self.grower = RegionGrower(config.grow, selection.seed_threshold)
        self.fitter = PaperFitter() if config.fit.kind == "paper" else TotalLeastSquaresFitter(config.fit, team)
        self.refiner = ImageRefiner(config.refine, team)

    def __call__(self, image: ArrayLike) -> LineSet:
        """Line segments of an image; raises InputError.

        Args:
            image: (H, W) grey, (H, W, 3) BGR or (H, W, 4) BGRA; uint8 or uint16; any size.
        """
        return self.trace(image).lines

    def trace(self, image: ArrayLike) -> Trace:
        """Line segments of an image with every intermediate result; same arguments and errors as calling."""
        return self.trace_edges(*self.detect_edges(image))

    def detect_edges(self, image: ArrayLike) -> tuple[NDArray[np.float32], Gray, float]:
        """(H, W) edge probability, the grey image, and the milliseconds that took: what `trace_edges` takes."""
        gray = to_gray(image)
        started = time.perf_counter()
        edges = self.edges.detect(gray)
        return edges, gray, 1e3 * (time.perf_counter() - started)

    def trace_edges(self, edges: NDArray[np.float32], gray: Gray | None = None, edges_ms: float = 0.0) -> Trace:
        """The stages after edge detection, on an edge map of your own.

        Args:
            edges: (H, W) float32 edge probability in [0, 1].
            gray: (H, W) the image; without it lines stay where the edge map has them.
            edges_ms: milliseconds to report for the edge stage.
        """
        spent = {"edges": edges_ms, **dict.fromkeys(("pixels", "orientation", "grow", "fit", "refine"), 0.0)}

        def timed(stage: str, work: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> T:
            started = time.perf_counter()
            result = work(*arguments, **named)
            spent[stage] = 1e3 * (time.perf_counter() - started)
            return result

        edges = np.ascontiguousarray(edges, np.float32)
        image = gray if gray is not None else (255 * edges).astype(np.uint8)
        selected = timed("pixels", self.pixels.select, edges)
        descriptors = timed("orientation", self.orientation.describe, selected.support, image, selected.pixels)
        regions = timed("grow", self.grower.grow, selected, descriptors)
        lines, labels = timed("fit", self.fitter.fit, selected, descriptors, regions)
        if gray is not None:
            lines = timed("refine", self.refiner.refine, lines, gray)
        return Trace(edges, selected.pixels, selected.positions, descriptors, labels, lines, spent)

    def detect_batch(self, images: Iterable[ArrayLike]) -> Iterator[LineSet]:
        """Line segments of many images of any sizes, in order, for work that is not live; raises InputError.

        The edge detector takes one image after the other in a thread of its own; the other stages work on one image for
        every two cores at once. Images are taken as they are needed.
        """

        def lines_of(detected: Future[tuple[NDArray[np.float32], Gray, float]]) -> LineSet:
            return self.trace_edges(*detected.result()).lines

        at_once = max(1, self._threads // 2)
        under_way: deque[Future[LineSet]] = deque()
        with ThreadPoolExecutor(1, "edges") as ahead, ThreadPoolExecutor(at_once, "lines") as behind:
            try:
                for image in images:
                    under_way.append(behind.submit(lines_of, ahead.submit(self.detect_edges, image)))
                    if len(under_way) > at_once:
                        yield under_way.popleft().result()
                while under_way:
                    yield under_way.popleft().result()
            finally:
                behind.shutdown(wait=False, cancel_futures=True)
                ahead.shutdown(wait=False, cancel_futures=True)

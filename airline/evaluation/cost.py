"""What the detector's time depends on: `python -m airline.bench --cost FILE.png`.

The picture shows time over image size and, at one size, over the number of lines, beside OpenCV's LSD.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.bench import load_pictures, measure
from airline.evaluation.plots import COLOURS, new_axes, save
from airline.scenes import RenderedClip

if TYPE_CHECKING:
    from airline.detector import AirLine

FACTORS = (0.5, 1, 1.5, 2, 3)  # sizes, relative to the one that is asked for
KINDS = ("indoor", "street", "shelves")
SEEDS = range(12, 18)
CURVES = (
    (COLOURS[1], "s", "OpenCV LSD", "lsd_ms"),
    (COLOURS[0], "o", "AirLine", "total_ms"),
    (COLOURS[2], "^", "of that, the stages after the network", "back_end_ms"),
)


@dataclass(frozen=True)
class Point:
    """Medians of one size or picture; `lines` were found on average."""

    megapixels: float
    lines: float
    network_ms: float
    total_ms: float
    lsd_ms: float

    @property
    def back_end_ms(self) -> float:
        """Of the stages after the network."""
        return self.total_ms - self.network_ms


def draw_cost(path: Path, detector: AirLine, images: Sequence[Path], size: tuple[int, int], rounds: int) -> str:
    """Measure over sizes around `size` and over pictures of that size, draw both, and give a table of the sizes.

    Raises:
        AirLineError: an image cannot be read, the picture not be written, or matplotlib is missing.
    """
    figure, (left, right) = new_axes(("image size, megapixels", "time, LSD = 1"), ("lines in a picture", ""))
    sizes = {factor: (round(factor * size[0]), round(factor * size[1])) for factor in FACTORS}
    over_sizes = {factor: _measure(detector, load_pictures(images, each), rounds) for factor, each in sizes.items()}
    singles = load_pictures(images, size) if images else [cv2.resize(view, size) for view in _scenes()]
    over_lines = [_measure(detector, [picture], 3 * rounds) for picture in singles]
    unit = float(np.median([point.lsd_ms for point in over_lines]))
    for axes, points, place in ((left, [*over_sizes.values()], "megapixels"), (right, over_lines, "lines")):
        for colour, marker, name, value in CURVES:
            x, y = [getattr(point, place) for point in points], [getattr(point, value) / unit for point in points]
            line = "-" if axes is left else "none"  # pictures with as many lines are not alike
            axes.plot(x, y, linestyle=line, color=colour, marker=marker, label=name)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    left.legend(fontsize=8)
    save(figure, path)
    rows = ["size       lines  network ms  other stages ms   LSD ms  LSD / ours"]
    for factor, point in over_sizes.items():
        name = "{}x{}".format(*sizes[factor])
        row = f"{name:10}{point.lines:6.0f}{point.network_ms:12.2f}{point.back_end_ms:17.2f}{point.lsd_ms:9.2f}"
        rows.append(f"{row}{point.lsd_ms / point.total_ms:12.2f}")
    return "\n".join([*rows, f"wrote {path}"])


def _scenes() -> list[NDArray[Any]]:
    """Grey pictures with few and with many lines."""
    clips = (RenderedClip(kind=kind, motion="handheld", seed=seed, frames=8) for kind, seed in product(KINDS, SEEDS))
    return [cv2.cvtColor(clip.render(0).image, cv2.COLOR_BGR2GRAY) for clip in clips]


def _measure(detector: AirLine, pictures: Sequence[NDArray[Any]], rounds: int) -> Point:
    figures, (height, width) = measure(detector, pictures, rounds), pictures[0].shape
    times = figures["stage_ms"]["edges"], figures["total_ms"], figures["lsd_ms"]
    return Point(width * height / 1e6, figures["lines"], *times)

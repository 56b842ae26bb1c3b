"""What the detector's time depends on: `python -m airline.bench --cost FILE.png`.

The picture shows time over image size and, at one size, over the number of lines, beside OpenCV's LSD.
"""

from __future__ import annotations

from collections.abc import Sequence
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
SCENES = [*product(("indoor", "street", "shelves"), range(12, 18))]  # kinds and seeds, with few and with many lines
CURVES = {
    "lsd": (COLOURS[1], "s", "OpenCV LSD"),
    "total": (COLOURS[0], "o", "AirLine"),
    "rest": (COLOURS[2], "^", "of that, the stages after the network"),
}


def draw_cost(path: Path, detector: AirLine, images: Sequence[Path], size: tuple[int, int], rounds: int) -> str:
    """Measure over sizes around `size` and over pictures of that size, draw both, and give a table of the sizes.

    Raises:
        AirLineError: an image cannot be read, the picture not be written, or matplotlib is missing.
    """
    figure, (left, right) = new_axes(("image size, megapixels", "time, LSD = 1"), ("lines in a picture", ""))
    sizes = [(round(factor * size[0]), round(factor * size[1])) for factor in FACTORS]
    over_sizes = [_measure(detector, load_pictures(images, each), rounds) for each in sizes]
    singles = load_pictures(images, size) if images else _scenes(size)
    over_lines = [_measure(detector, [picture], 3 * rounds) for picture in singles]
    unit = float(np.median([point["lsd"] for point in over_lines]))
    for axes, points, place in ((left, over_sizes, "megapixels"), (right, over_lines, "lines")):
        for key, (colour, marker, name) in CURVES.items():
            x, y = [point[place] for point in points], [point[key] / unit for point in points]
            line = "-" if axes is left else "none"  # pictures with as many lines are not alike
            axes.plot(x, y, linestyle=line, color=colour, marker=marker, label=name)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    left.legend(fontsize=8)
    save(figure, path)
    rows = ["size       lines  network ms  other stages ms   LSD ms  LSD / ours"]
    for (width, height), point in zip(sizes, over_sizes, strict=True):
        row = (
            f"{f'{width}x{height}':10}{point['lines']:6.0f}{point['total'] - point['rest']:12.2f}{point['rest']:17.2f}"
        )
        rows.append(f"{row}{point['lsd']:9.2f}{point['lsd'] / point['total']:12.2f}")
    return "\n".join([*rows, f"wrote {path}"])


def _scenes(size: tuple[int, int]) -> list[NDArray[Any]]:
    """Grey pictures with few and with many lines."""
    views = (RenderedClip(kind, "handheld", seed, frames=8, size=size).render(0) for kind, seed in SCENES)
    return [cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY) for view in views]


def _measure(detector: AirLine, pictures: Sequence[NDArray[Any]], rounds: int) -> dict[str, float]:
    """Megapixels, lines, and medians in ms: of the detector, of its stages after the network, of LSD."""
    figures = measure(detector, pictures, rounds)
    return {
        "megapixels": pictures[0].size / 1e6,
        "lines": figures["lines"],
        "total": figures["total_ms"],
        "rest": figures["total_ms"] - figures["stage_ms"]["edges"],
        "lsd": figures["lsd_ms"],
    }

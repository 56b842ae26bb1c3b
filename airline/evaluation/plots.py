"""Plots of evaluated detectors: `python -m airline.evaluation.plots EVAL.json [MORE_EVAL.json ...] --out DIR`.

The files are what `python -m airline.evaluate --json` writes; the first one brings our detector and LSD. Written are
`lp_curve.png` and `performance.png`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np

from airline.command import Parser, exit_code
from airline.errors import ConfigError, InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Percent = Annotated[float, msgspec.Meta(ge=0, le=100)]
Milliseconds = Annotated[float, msgspec.Meta(gt=0)]

# Okabe and Ito's colours, which colour-blind people tell apart; a marker each for those who print in grey
COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"]
MARKERS = ["o", "s", "^", "D", "v", "P", "X"]
DPI = 160


class Scores(msgspec.Struct, frozen=True):
    """What the plots need of a detector's figures: LP per radius, precision and F-score at 2 px, median time."""

    lp: Annotated[dict[int, Percent], msgspec.Meta(min_length=1)]
    p2: Percent
    f2: Percent
    ms: Milliseconds | None = None


class Evaluation(Scores, frozen=True):
    """The file of an evaluation, with LSD's figures where it ran beside."""

    lsd: Scores | None = None


def read_evaluation(path: Path) -> Evaluation:
    """The figures in a file.

    Raises:
        InputError: the file is missing or is no evaluation.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=Evaluation)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path} is no evaluation ({error}): write one with python -m airline.evaluate DATASET_DIR --json FILE"
        ) from None


def read_rivals(paths: list[Path]) -> dict[str, Scores]:
    """Scores by name: ours and LSD's of the first file, and those of the further files under their stems.

    The machine is not equally fast from run to run: times of the further files are scaled so that LSD, which ran beside
    each, took as long as in the first one.

    Raises:
        InputError: a file cannot be used, two have one name, or the first one lacks LSD or the times.
    """
    ours = read_evaluation(paths[0])
    if ours.lsd is None or ours.ms is None or ours.lsd.ms is None:
        raise InputError(f"{paths[0]} has no times or no LSD: give an evaluation of our own detector first")
    rivals: dict[str, Scores] = {"AirLine": ours, "LSD": ours.lsd}
    for path in paths[1:]:
        if path.stem in rivals:
            raise InputError(f"two detectors are called {path.stem}: rename {path}")
        rival = read_evaluation(path)
        if rival.ms is not None and rival.lsd is not None and rival.lsd.ms is not None:
            rival = msgspec.structs.replace(rival, ms=rival.ms * ours.lsd.ms / rival.lsd.ms)
        rivals[path.stem] = rival
    return rivals


def draw_lp_curve(rivals: dict[str, Scores]) -> Figure:
    """LP over the radius; every legend entry carries the precision, since LP is a recall."""
    figure, (axes,) = new_axes(("distance r to the nearest detected pixel, px", "LP$_r$, % of the annotated pixels"))
    for (name, scores), style in zip(rivals.items(), _styles(), strict=False):
        radii = sorted(scores.lp)
        label = f"{name}, P2 {scores.p2:.1f} %"
        axes.plot(radii, [scores.lp[radius] for radius in radii], label=label, markersize=6, **style)
    axes.set_xticks(sorted({radius for scores in rivals.values() for radius in scores.lp}))
    axes.set_ylim(top=100)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", title="P2: precision within 2 px")
    return figure


def draw_performance(rivals: dict[str, Scores]) -> Figure:
    """F2 over frames per second with curves of equal product; detectors without a time are left out."""
    figure, (axes,) = new_axes(("frames per second", "F-score at 2 px, %"))
    from matplotlib.ticker import MaxNLocator

    points = []
    for (name, scores), style in zip(rivals.items(), _styles(), strict=False):
        if scores.ms is not None:
            point = (1e3 / scores.ms, scores.f2)
            points.append(point)
            axes.plot(*point, markersize=9, **style)
            plate = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}
            axes.annotate(name, point, xytext=(8, 6), textcoords="offset points", bbox=plate)
    fastest, highest = np.max(points, axis=0)
    axes.set_xlim(0, 1.3 * fastest)
    axes.set_ylim(max(0, np.min(points, axis=0)[1] - 15), min(100, highest + 15))
    speed, score = np.meshgrid(np.linspace(*axes.get_xlim(), 200), np.linspace(*axes.get_ylim(), 200))
    product = speed * score / 100
    levels = MaxNLocator(8).tick_values(0, product.max())[1:]
    curves = axes.contour(speed, score, product, levels=levels, colors="0.6", linewidths=0.8)
    axes.clabel(curves, fmt="%g", fontsize=8)
    axes.set_title("grey: F-score (as a share) times frames per second", fontsize=10, color="0.4")
    return figure


def new_axes(*labels: tuple[str, str]) -> tuple[Figure, list[Axes]]:
    """An empty figure with axes side by side, for each its labels (x, y).

    Raises:
        ConfigError: matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ConfigError("plots need matplotlib: pip install 'airline-frontend[plots]'") from None
    figure = Figure(figsize=(2.5 + 4 * len(labels), 4.2), layout="constrained")
    row = [figure.add_subplot(1, len(labels), k + 1) for k in range(len(labels))]
    for axes, (x_label, y_label) in zip(row, labels, strict=True):
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, row


def _styles() -> Iterator[dict[str, Any]]:
    """The same styles in the same order for both plots; more than seven detectors begin again."""
    return cycle({"color": colour, "marker": marker} for colour, marker in zip(COLOURS, MARKERS, strict=True))


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(prog="python -m airline.evaluation.plots", description="Plot evaluated detectors.")
    parser.add_argument(
        "evaluations",
        type=Path,
        nargs="+",
        metavar="EVAL.json",
        help="files of python -m airline.evaluate --json; the first one brings our detector and LSD, each further "
        "one a detector that is named like its file",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the PNG files")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Write both plots and say where.

    Raises:
        AirLineError: a file or folder cannot be used, or matplotlib is missing.
    """
    rivals = read_rivals(options.evaluations)
    figures = {"lp_curve.png": draw_lp_curve(rivals), "performance.png": draw_performance(rivals)}
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        for name, figure in figures.items():
            figure.savefig(options.out / name, dpi=DPI, metadata={"Software": None})
            print(f"wrote {options.out / name}")
    except OSError as error:
        raise InputError(f"plots cannot be written to {options.out} ({error.strerror}): give another --out") from None


if __name__ == "__main__":
    sys.exit(main())

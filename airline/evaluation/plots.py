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
from airline.errors import InputError, from_extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Percent = Annotated[float, msgspec.Meta(ge=0, le=100)]
Milliseconds = Annotated[float, msgspec.Meta(gt=0)]

# Okabe and Ito's colours, which colour-blind people tell apart; a marker each for those who print in grey
COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"]
MARKERS = ["o", "s", "^", "D", "v", "P", "X"]


class Scores(msgspec.Struct, frozen=True):
    """What the plots need of a detector's figures: LP per radius, precision and F-score at 2 px, median time."""

    lp: Annotated[dict[int, Percent], msgspec.Meta(min_length=1)]
    p2: Percent
    f2: Percent
    ms: Milliseconds | None = None


class Evaluation(Scores, frozen=True):
    """The file of an evaluation, with LSD's figures where it ran beside."""

    lsd: Scores | None = None


def read_rivals(paths: list[Path]) -> dict[str, Scores]:
    """Scores by name: ours and LSD's of the first file, and those of the further files under their stems.

    Times of the further files are scaled so that LSD, which ran beside each, took as long as in the first one. Raises
    InputError where a file cannot be used, two have one name, or the first one lacks LSD or the times.
    """
    ours, *others = (_read(path) for path in paths)
    if ours.lsd is None or ours.ms is None or ours.lsd.ms is None:
        raise InputError(f"{paths[0]} has no times or no LSD: give an evaluation of our own detector first")
    rivals: dict[str, Scores] = {"AirLine": ours, "LSD": ours.lsd}
    for path, rival in zip(paths[1:], others, strict=True):
        if path.stem in rivals:
            raise InputError(f"two detectors are called {path.stem}: rename {path}")
        if rival.ms is not None and rival.lsd is not None and rival.lsd.ms is not None:
            rival = msgspec.structs.replace(rival, ms=rival.ms * ours.lsd.ms / rival.lsd.ms)
        rivals[path.stem] = rival
    return rivals


def _read(path: Path) -> Evaluation:
    try:
        return msgspec.json.decode(path.read_bytes(), type=Evaluation)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path} is no evaluation ({error}): write one with python -m airline.evaluate DATASET_DIR --json FILE"
        ) from None


def draw_lp_curve(rivals: dict[str, Scores]) -> Figure:
    """LP over the radius; every legend entry carries the precision, since LP is a recall."""
    figure, (axes,) = new_axes(("distance r to the nearest detected pixel, px", "LP$_r$, % of the annotated pixels"))
    for (name, scores), style in zip(rivals.items(), _styles(), strict=False):
        radii, label = sorted(scores.lp), f"{name}, P2 {scores.p2:.1f} %"
        axes.plot(radii, [scores.lp[radius] for radius in radii], label=label, markersize=6, **style)
    axes.set_xticks(sorted({radius for scores in rivals.values() for radius in scores.lp}))
    axes.set_ylim(top=100)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", title="P2: precision within 2 px")
    return figure


def draw_performance(rivals: dict[str, Scores]) -> Figure:
    """F2 over frames per second with curves of equal product; detectors without a time are left out."""
    figure, (axes,) = new_axes(("frames per second", "F-score at 2 px, %"))
    points = []
    for (name, scores), style in zip(rivals.items(), _styles(), strict=False):
        if scores.ms is not None:
            points.append((1e3 / scores.ms, scores.f2))
            axes.plot(*points[-1], markersize=9, **style)
            plate = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}
            axes.annotate(name, points[-1], xytext=(8, 6), textcoords="offset points", bbox=plate)
    (fastest, highest), lowest = np.max(points, axis=0), np.min(points, axis=0)[1]
    axes.set(xlim=(0, 1.3 * fastest), ylim=(max(0, lowest - 15), min(100, highest + 15)))
    speed, score = np.meshgrid(np.linspace(*axes.get_xlim(), 200), np.linspace(*axes.get_ylim(), 200))
    curves = axes.contour(speed, score, speed * score / 100, levels=8, colors="0.6", linewidths=0.8)
    axes.clabel(curves, fmt="%g", fontsize=8)
    axes.set_title("grey: F-score (as a share) times frames per second", fontsize=10, color="0.4")
    return figure


def new_axes(*labels: tuple[str, str]) -> tuple[Figure, list[Axes]]:
    """An empty figure with axes side by side, for each its labels (x, y); ConfigError where matplotlib is missing."""
    with from_extra("plots"):
        from matplotlib.figure import Figure
    figure = Figure(figsize=(2.5 + 4 * len(labels), 4.2), layout="constrained")
    row = [figure.add_subplot(1, len(labels), k + 1) for k in range(len(labels))]
    for axes, (x_label, y_label) in zip(row, labels, strict=True):
        axes.set(xlabel=x_label, ylabel=y_label)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, row


def save(figure: Figure, path: Path) -> None:
    """Write a picture; InputError where that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=160, metadata={"Software": None})
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}): give another place") from None


def _styles() -> Iterator[dict[str, Any]]:
    """The same styles in the same order for both plots; more than seven detectors begin again."""
    return cycle({"color": colour, "marker": marker} for colour, marker in zip(COLOURS, MARKERS, strict=True))


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
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
    return exit_code(run, parser.parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Write both plots and say where; raises AirLineError."""
    rivals = read_rivals(options.evaluations)
    for name, draw in {"lp_curve.png": draw_lp_curve, "performance.png": draw_performance}.items():
        save(draw(rivals), options.out / name)
        print(f"wrote {options.out / name}")


if __name__ == "__main__":
    sys.exit(main())

"""Score the detector on annotated images, beside OpenCV's LSD: `python -m airline.evaluate DATASET_DIR`.

The data set has `images/`, `lines_denis/` (sparse annotation) and `lines_cho/` (dense annotation), as YorkUrban is
handed around: a text file per image, a line `x0 y0 x1 y1` per row, px, centre of the top-left pixel at (0, 0).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from airline.command import Parser, exit_code, number, track, write_json
from airline.config import PRESETS, RUNTIMES
from airline.errors import ConfigError

if TYPE_CHECKING:
    from rich.table import Table

    from airline.evaluation.benchmark import Detect, Figures

PIXELS = ("p2", "r2", "f2")  # all detectors have them, in any light
LINES = {"lines": 1, "repeatability": 3, "localisation": 3, "ms": 1}  # decimals
TITLES = {"localisation": "localisation, px", "ms": "median ms"}
LEGEND = """\
LPr: share of the sparsely annotated pixels within r px of a detection, %;
  it is a recall, so read it beside P2.
P2, R2, F2: precision and recall within 2 px of the dense annotation, and their
  F-score, %. F1: the F-score at 1 px.
Repeatability, localisation: of three random views per image under other light,
  the share of lines that match one to one within 3 px, and the mean distance of
  the 50 best matches.
Bad light: a quarter of the light with noise; 9 px of motion blur; twice the
  light, clipped. "LSD, prepared" is LSD after the blur, sharpening or stretch
  that helps it most."""


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m airline.evaluate",
        description="Score the line detector on annotated images, with OpenCV's LSD beside it.",
        epilog=LEGEND,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("dataset", type=Path, help="folder with images/, lines_denis/ (sparse), lines_cho/ (dense)")
    add("--limit", type=number(int, 1), metavar="N", help="use only the first N images")
    add("--preset", help=f"{', '.join(PRESETS)} (default: default)")
    add("--weights", metavar="FILE", help="weights of the edge network instead of the bundled ones")
    add("--runtime", choices=RUNTIMES, help="where the edge network runs (default: auto)")
    add("--predictions", type=Path, metavar="DIR", help="score text files of lines instead, one per image")
    add("--ablate", action="store_true", help="exchange one part of the default detector at a time instead")
    parser.add_json()
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Evaluate, print the tables and write the JSON; raises AirLineError."""
    from rich.console import Console

    from airline.evaluation import ablation, benchmark
    from airline.evaluation.dataset import load_dataset

    given = [name for name in ("ablate", "predictions", "preset", "weights", "runtime") if getattr(options, name)]
    if len(given) > 1 and given[0] in ("ablate", "predictions"):
        raise ConfigError(f"--{given[0]} does not go with --{given[1]}: leave one of them away")
    samples = load_dataset(options.dataset, options.limit)
    shown = track(samples, "images", len(samples))
    console, legend = Console(width=110 if options.ablate else None), LEGEND
    if options.ablate:
        rows, legend = ablation.measure_variants(shown), ablation.LEGEND
        decimals = {**dict.fromkeys(PIXELS, 1), "lines": 0, "ms": 1}
        printed = [_table("Ablation, %", rows, decimals, {"ms": "ms"})]
        figures = {"rows": [{"name": name, **rows[name]} for name in rows]}
    elif options.predictions is not None:
        figures = benchmark.measure_files(shown, options.predictions)
        printed = tables(options.predictions.resolve().name, figures)
    else:
        figures = benchmark.measure(shown, _detector(options))
        name = "AirLine" if options.preset in (None, "default") else f"AirLine, {options.preset}"
        printed = tables(name, figures)
    for table in printed:
        console.print(table)
    console.print(legend, highlight=False)
    write_json(options.json, {"images": len(samples), **figures})


def _detector(options: argparse.Namespace) -> Detect:
    import msgspec

    from airline.config import preset
    from airline.detector import AirLine

    config = preset(options.preset or "default")
    if options.weights is not None:
        config = msgspec.structs.replace(config, edges=msgspec.structs.replace(config.edges, weights=options.weights))
    detector = AirLine(config=config, runtime=options.runtime or "auto")
    return lambda image: detector(image).segments


def tables(name: str, figures: Figures) -> list[Table]:
    """What was measured of the detector `name`, and of LSD where that ran beside it."""
    rivals = {name: figures} | ({"LSD": figures["lsd"]} if "lsd" in figures else {})
    found = [
        _table("Scores, %", rivals, dict.fromkeys((*PIXELS, "f1"), 1)),
        _table("Lines per image", rivals, {key: n for key, n in LINES.items() if key in figures}, lp=False),
    ]
    if "bad_light" in figures:
        rows = {}
        for light, scores in figures["bad_light"].items():
            entries = {name: scores, "LSD": scores["lsd"], "LSD, prepared": scores["lsd_prepared"]}
            rows.update({f"{light}: {row}": entry for row, entry in entries.items()})
        found.append(_table("Bad light, %", rows, dict.fromkeys(PIXELS, 1), lp=False))
    return found


def _table(
    title: str, rows: dict[str, Figures], decimals: dict[str, int], titles: dict[str, str] = TITLES, lp: bool = True
) -> Table:
    """Figures by name; what a row lacks is a dash."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table("", title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    radii = [*next(iter(rows.values()))["lp"]] if lp else []
    names = (titles.get(key, key.upper() if key in (*PIXELS, "f1") else key) for key in decimals)
    for column in (*(f"LP{radius}" for radius in radii), *names):
        table.add_column(column, justify="right")
    for name, figures in rows.items():
        values = [(figures["lp"][radius], 1) for radius in radii] + [(figures[key], n) for key, n in decimals.items()]
        table.add_row(name, *("-" if value is None else f"{value:.{n}f}" for value, n in values))
    return table


if __name__ == "__main__":
    sys.exit(main())

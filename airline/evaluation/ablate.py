"""Exchange one part of the detector at a time and score it: `python -m airline.evaluation.ablate DATASET_DIR`.

The data set is laid out as for `python -m airline.evaluate`.
"""

from __future__ import annotations

import argparse
import sys

from airline.command import Parser, exit_code, write_json
from airline.evaluation.command import add_dataset, open_dataset, track

LEGEND = """\
Every row is the default with what the row names exchanged, in good light.
LPr, P2, R2, F2: see python -m airline.evaluate --help. LPr is a recall, and no score minds several
  lines on one edge, so read them all beside the number of lines per image.
ms: median time of the stages after the edge map; for LSD, of everything.
T: similarity at which a pixel joins a region, 0.6 in the default. The rows that name it compare
  descriptors (the paper's table III), each at the T with its best F2 of a sweep on every second
  image of YorkUrban's training half. Mean: the mean over the channels is not taken away; of two
  channels that would leave nothing but which one is larger. The image gradient is compared with
  its sign.
Paper's line fit: its voting, with each vector's sign turned to agree with the sum. Bare least
  squares: likewise no cutting of bent regions, joining, end-point reach or minimum length.
No thinning: every pixel of at least the threshold, described by the binary map.
Canny: thresholds 50 and 150, sigma 1 px. Sensitive Canny: 30 and 90, 0.7 px, the best F2 of seven
  settings on every fourth image.
Hough transform: OpenCV's probabilistic one on the thin edges; cells of 1 px and 1 degree, 20 votes,
  lines of at least 10 px, gaps up to 8 px, the best F2 of 27 settings on every fourth image."""


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m airline.evaluation.ablate",
        description="Score the line detector with one part exchanged at a time, on annotated images.",
        epilog=LEGEND,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_dataset(parser)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Measure all variants, print the table and write the JSON.

    Raises:
        AirLineError: an argument or file cannot be used.
    """
    from rich.console import Console

    from airline.evaluation.ablation import measure_variants
    from airline.evaluation.tables import ablation

    samples = open_dataset(options)
    rows = measure_variants(track(samples))
    console = Console(width=100)
    console.print(ablation(rows))
    console.print(LEGEND, highlight=False)
    write_json(options.json, {"images": len(samples), "rows": [{"name": name, **rows[name]} for name in rows]})


if __name__ == "__main__":
    sys.exit(main())

"""Pair the lines of two images, without a video: `python -m frontend.match A.png B.png --picture pairs.png`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from airline.command import Parser, exit_code
from airline.errors import InputError, errors_of

COLUMNS = "first,second,vote,first_x0,first_y0,first_x1,first_y1,second_x0,second_y0,second_x1,second_y1"


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m frontend.match",
        description="Pair the lines of two images of the same things, from near or far apart.",
    )
    parser.add_argument("first", type=Path, help="image file")
    parser.add_argument("second", type=Path, help="image file, of any size")
    parser.add_argument("--calib", type=Path, metavar="FILE", help="of the camera that took both: essential matrix")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help=".csv to write: rows, votes and end points of the pairs"
    )
    parser.add_argument("--picture", type=Path, metavar="FILE", help=".png or .jpg: pairs in the same colours")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Match, print what was found, write what was asked for; raises AirLineError."""
    for path, endings in ((options.out, (".csv",)), (options.picture, (".png", ".jpg"))):
        if path is not None and (path.suffix.lower() not in endings or not path.parent.is_dir()):
            raise InputError(f"cannot write {path}: give a name that ends with {endings[0]} in a folder that exists")
        if path is not None and path.resolve() in (options.first.resolve(), options.second.resolve()):
            raise InputError(f"cannot write {path}: it is an input; give another name")

    from frontend.camera.calibration import read_calibration
    from frontend.matching import match_lines
    from frontend.sources.stills import read_image

    camera = None if options.calib is None else read_calibration(options.calib, options.first).camera
    images = read_image(options.first), read_image(options.second)
    matches = match_lines(*images, camera=camera)
    for note in matches.notes:
        print(f"note: {note}")
    pairs, counts = len(matches.pairs), (len(matches.first), len(matches.second))
    print(f"lines: {counts[0]} and {counts[1]}; pairs: {pairs}; alone: {counts[0] - pairs} and {counts[1] - pairs}")
    print(f"geometry: {matches.geometry}; points: {matches.points}, of which {matches.inliers} agree with it")
    if options.out is not None:
        rows = zip(matches.pairs.T, (matches.first, matches.second), strict=True)
        ends = [lines.segments[row].reshape(-1, 4).tolist() for row, lines in rows]
        table = zip(matches.pairs.tolist(), matches.votes.tolist(), *ends, strict=True)
        text = [f"{a},{b},{vote:.4f},{','.join(f'{x:.3f}' for x in (*p, *q))}" for (a, b), vote, p, q in table]
        with errors_of(options.out):
            options.out.write_text("\n".join([COLUMNS, *text, ""]), encoding="utf-8")
    if options.picture is not None:
        from frontend.cli.wiring import write_pairs

        write_pairs(options.picture, images, matches)


if __name__ == "__main__":
    sys.exit(main())

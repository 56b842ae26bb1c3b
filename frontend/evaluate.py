"""Measure the line tracker against known identities: `python -m frontend.evaluate`.

Without arguments the clips are the rendered ones, which are built in. Photographs, labelled frames and clips with poses
come from folders.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sized
from pathlib import Path
from typing import TYPE_CHECKING

from airline.command import Parser, exit_code, write_json
from airline.errors import InputError
from frontend.cli.terminal import progress

if TYPE_CHECKING:
    from frontend.evaluation.clip import Clip
    from frontend.evaluation.posed import PosedClip


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m frontend.evaluate",
        description="Measure the line tracker against known identities, beside nearest neighbour and optical flow.",
    )
    parser.add_argument(
        "--sequence", nargs="+", metavar="NAME", help="only these clips, by the names that the table shows"
    )
    parser.add_argument("--photos", type=Path, metavar="DIR", help="also photographs of a folder, moved and degraded")
    parser.add_argument("--icl", type=Path, metavar="DIR", help="also frames with labelled lines and associations")
    parser.add_argument("--posed", type=Path, metavar="DIR", help="also a clip with poses, as KITTI has them")
    parser.add_argument("--limit", type=int, metavar="N", help="use only the first N frames of each clip")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as JSON")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Evaluate, print the tables and write the JSON.

    Raises:
        AirLineError: an argument or file cannot be used.
    """
    if options.limit is not None and options.limit < 2:
        raise InputError("--limit must be at least 2: a track needs two frames")
    if options.json is not None and not options.json.parent.is_dir():
        raise InputError(f"no folder {options.json.parent}: create it, or give another --json file")
    from rich.console import Console

    from frontend.evaluation.measure import airline, measure, measure_posed
    from frontend.evaluation.tables import LEGEND, posed_table, sequence_tables

    clips, posed_clips = _chosen(options)
    detect = airline()
    sequences, posed = {}, {}
    for clip in clips:
        with progress(clip.name, _length(clip, options.limit)) as tick:
            sequences[clip.name] = measure(clip, detect, options.limit, tick)
    for posed_clip in posed_clips:
        with progress(posed_clip.name, _length(posed_clip, options.limit)) as tick:
            posed[posed_clip.name] = measure_posed(posed_clip, detect, options.limit, tick)
    console = Console()
    if sequences:
        for table in sequence_tables(sequences):
            console.print(table)
    if posed:
        console.print(posed_table(posed))
    console.print(LEGEND)
    write_json(options.json, {"sequences": sequences, "posed": posed})


def _chosen(options: argparse.Namespace) -> tuple[list[Clip], list[PosedClip]]:
    """Clips with known identities and clips with known poses that the arguments name."""
    from frontend.evaluation.rendered import rendered_clips

    clips, posed = rendered_clips(), []
    if options.photos is not None:
        from frontend.evaluation.moved import moved_photos

        clips += moved_photos(options.photos)
    if options.icl is not None:
        from frontend.evaluation.icl import LabelledClip

        clips.append(LabelledClip(options.icl))
    if options.posed is not None:
        from frontend.evaluation.posed import PosedClip

        posed.append(PosedClip(options.posed))
    names = [clip.name for clip in clips] + [clip.name for clip in posed]
    wanted = options.sequence or names
    for name in wanted:
        if name not in names:
            raise InputError(f"no sequence '{name}': there are {', '.join(names)}")
    return [clip for clip in clips if clip.name in wanted], [clip for clip in posed if clip.name in wanted]


def _length(clip: Sized, limit: int | None) -> int:
    return len(clip) if limit is None else min(limit, len(clip))


if __name__ == "__main__":
    sys.exit(main())

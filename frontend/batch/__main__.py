"""The command line of `frontend.batch`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from airline.command import EXIT_USER_ERROR, Parser
from airline.errors import AirLineError
from frontend.batch import BatchInterrupted, Row, run_batch
from frontend.batch.job import OUTPUTS, REPORT
from frontend.cli.flags import add_settings, settings_of
from frontend.cli.settings import load
from frontend.cli.signals import EXIT_INTERRUPTED, ending_like_interrupts
from frontend.cli.terminal import set_up_logging

EXIT_SOME_FAILED = 1


def build_parser() -> argparse.ArgumentParser:
    """All flags."""
    parser = Parser(
        prog="python -m frontend.batch",
        description="Run the frontend over many recordings, and go on where the last batch ended.",
        epilog="Exit code: 0, 1 when a recording failed, 2 for errors you can mend, 130 after Ctrl-C.",
        allow_abbrev=False,
    )
    recordings = "videos, logs, bag folders, image folders, and globs of such"
    parser.add_argument("inputs", nargs="+", metavar="RECORDING", help=recordings)
    add = parser.add_argument_group("output").add_argument
    add("--out", type=Path, required=True, metavar="DIR", help="folder of all results")
    kinds = f"what to write for each recording: {', '.join(OUTPUTS)} (default: parquet)"
    add("--write", nargs="+", default=["parquet"], choices=list(OUTPUTS), metavar="KIND", help=kinds)
    add("--overwrite", action="store_true", help="run recordings that have results, too")
    add = parser.add_argument_group("where it runs").add_mutually_exclusive_group().add_argument
    add("--workers", type=int, metavar="N", help="recordings at once (default: one per two cores)")
    addresses = "on a Ray cluster: local, auto, HOST:PORT or ray://HOST:PORT; see docs/batch.md"
    add("--ray", metavar="ADDRESS", help=addresses)
    add_settings(parser)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    options = build_parser().parse_args(arguments)
    set_up_logging(0)
    try:
        code, config = 0, load(options.config, settings_of(options))
        given = {name: getattr(options, name) for name in ("write", "workers", "ray", "overwrite")}
        try:
            with ending_like_interrupts():
                rows = run_batch(options.inputs, options.out, config=config, **given)
        except BatchInterrupted as stop:
            rows, code = stop.rows, EXIT_INTERRUPTED
        print(*summary_lines(rows), f"report: {options.out / REPORT}", sep="\n")
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    return code or (EXIT_SOME_FAILED if any(row.status == "failed" for row in rows) else 0)


def summary_lines(rows: list[Row]) -> list[str]:
    """What became of how many recordings, and the reasons of those that failed."""
    lines = []
    for status in ("done", "skipped", "failed", "pending"):
        found = [row for row in rows if row.status == status]
        if found:
            sums = (sum(getattr(row, name) or 0 for row in found) for name in ("frames", "tracks", "seconds"))
            lines.append("{}: {} recordings, {} frames, {} tracks, {:.1f} s".format(status, len(found), *sums))
    lines += [f"failed {row.name}: {row.reason}" for row in rows if row.status == "failed"]
    return [line.encode("utf-8", "replace").decode() for line in lines]  # file names may hold bytes that are no text


if __name__ == "__main__":
    sys.exit(main())

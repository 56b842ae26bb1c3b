"""The frontend over many recordings: `python -m frontend.batch 'logs/*.mcap' --out results`.

Each recording gets a folder in the output folder, with its tracks and `summary.json`. The folder appears when it is
complete, so whatever ends a batch, the same command goes on from there: it skips the recordings that have results and
runs those that failed or never ran. Recordings that have changed since, and all when the settings change, are run
again; their earlier results stay until the new ones take their place. `report.parquet` has a row for each recording.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from airline.command import EXIT_USER_ERROR, Parser
from airline.errors import AirLineError, ConfigError
from frontend.cli.flags import add_settings, settings_of
from frontend.cli.signals import EXIT_INTERRUPTED, ending_like_interrupts
from frontend.cli.terminal import progress, set_up_logging
from frontend.fleet.job import OUTPUTS, Recipe, Row

if TYPE_CHECKING:
    from frontend.cli.settings import RunConfig
    from frontend.fleet.report import Report
    from frontend.fleet.workers import Workers

__all__ = ["run_batch"]

log = logging.getLogger("frontend.batch")

EXIT_SOME_FAILED = 1


def run_batch(
    inputs: Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    *,
    config: RunConfig | None = None,
    write: Sequence[str] = ("parquet",),
    workers: int | None = None,
    ray: str | None = None,
    overwrite: bool = False,
) -> list[Row]:
    """Run the frontend over many recordings; one that fails leaves the others alone.

    Workers are processes that import the calling script, which therefore needs `if __name__ == "__main__":`.

    Args:
        inputs: files, folders or globs: videos, logs, bag folders, image folders.
        out: the folder of all results, made if need be.
        config: settings of each run, see `frontend.cli.settings.load`.
        write: what to write for each recording: "parquet", "mcap", "csv", "limap", "plvins" or "rrd".
        workers: how many recordings run at once on this machine; by default one per two cores.
        ray: run on Ray instead: "local", "auto", "HOST:PORT" or "ray://HOST:PORT". All nodes need this package, and the
            inputs and `out` under the same paths.
        overwrite: run recordings that have results, too.

    Returns:
        A row for each recording, as `report.parquet` in `out` holds them.

    Raises:
        AirLineError: an input without a recording, an impossible setting, an output that cannot be written.
        KeyboardInterrupt: after the report has been written; what was finished stays.
    """
    from frontend.cli.settings import RunConfig

    report, interrupted = _run(inputs, Path(out), config or RunConfig(), tuple(write), workers, ray, overwrite)
    if interrupted:
        raise KeyboardInterrupt
    return report.rows


def _run(
    inputs: Sequence[str | os.PathLike[str]],
    out: Path,
    config: RunConfig,
    write: tuple[str, ...],
    workers: int | None,
    ray: str | None,
    overwrite: bool,
) -> tuple[Report, bool]:
    """What became of all recordings, and whether Ctrl-C came first."""
    from frontend.fleet.inputs import find_recordings
    from frontend.fleet.plan import REPORT, make_plan, reserved, with_absolute_paths
    from frontend.fleet.report import Report
    from frontend.fleet.workers import run_all

    if workers is not None and (workers < 1 or ray is not None):
        raise ConfigError("the number of workers must be 1 or more, and is for this machine, not for Ray")
    if not write or not OUTPUTS.keys() >= set(write):
        raise ConfigError(f"cannot write {', '.join(write) or 'nothing'}: choose from {', '.join(OUTPUTS)}")
    recipe = Recipe(with_absolute_paths(config), tuple(dict.fromkeys(write)))
    paths = find_recordings(inputs, out)
    with reserved(out):
        plan = make_plan(paths, out.absolute(), recipe, overwrite=overwrite)
        if plan.outdated:
            log.warning("running again, as input or settings have changed: %d", plan.outdated)
        with closing(_open_workers(workers, ray, recipe, len(plan.jobs))) as pool:
            report = Report(out / REPORT, plan.rows)
            interrupted = _collect(run_all(plan.jobs, pool), report, len(plan.jobs))
    return report, interrupted


def _collect(rows: Iterable[Row], report: Report, total: int) -> bool:
    """Bring the report up to date as recordings end; whether Ctrl-C came before the last one."""
    try:
        with progress("batch", total, unit="recordings") as advance:
            for row in rows:
                for warning in row.warnings:
                    log.warning("%s", warning if warning.startswith(row.name) else f"{row.name}: {warning}")
                report.update(row)
                advance()
    except KeyboardInterrupt:
        log.warning("interrupted: what was finished is kept, and the same command goes on from there")
        return True
    finally:
        report.write()
    return False


def _open_workers(workers: int | None, ray: str | None, recipe: Recipe, jobs: int) -> Workers:
    if ray is not None and jobs:
        from frontend.fleet.ray_cluster import RayWorkers

        return RayWorkers(ray, recipe)
    from airline.kernels.threads import cores
    from frontend.fleet.local import LocalWorkers

    count = max(1, min(jobs, workers or cores() // 2))
    return LocalWorkers(count, replace(recipe, cores=max(1, cores() // count)))


def build_parser() -> argparse.ArgumentParser:
    """All flags."""
    parser = Parser(
        prog="python -m frontend.batch",
        description="Run the frontend over many recordings, and go on where the last batch ended.",
        epilog="Exit code: 0, 1 when a recording failed, 2 for errors you can mend, 130 after Ctrl-C.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "inputs", nargs="+", metavar="RECORDING", help="videos, logs, bag folders, image folders, and globs of such"
    )
    output = parser.add_argument_group("output")
    output.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of all results")
    output.add_argument(
        "--write",
        nargs="+",
        default=["parquet"],
        choices=list(OUTPUTS),
        metavar="KIND",
        help=f"what to write for each recording: {', '.join(OUTPUTS)} (default: parquet)",
    )
    output.add_argument("--overwrite", action="store_true", help="run recordings that have results, too")
    where = parser.add_argument_group("where it runs").add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, metavar="N", help="recordings at once (default: one per two cores)")
    where.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="on a Ray cluster: local, auto, HOST:PORT or ray://HOST:PORT; see docs/batch.md",
    )
    add_settings(parser)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    options = build_parser().parse_args(arguments)
    set_up_logging(0)
    try:
        from rich.console import Console

        from frontend.cli.settings import load

        config = load(options.config, settings_of(options))
        outputs = tuple(options.write)
        with ending_like_interrupts():
            report, interrupted = _run(
                options.inputs, options.out, config, outputs, options.workers, options.ray, options.overwrite
            )
        Console().print(report.table())
        failures = report.failures()
        for failure in failures:
            print(f"failed {failure}")
        print(f"report: {report.path}")
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    if interrupted:
        return EXIT_INTERRUPTED
    return EXIT_SOME_FAILED if failures else 0


if __name__ == "__main__":
    sys.exit(main())

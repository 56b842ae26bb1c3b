"""The frontend over many recordings: `python -m frontend.batch 'logs/*.mcap' --out results`.

Each recording is a process of `python -m frontend.run` and gets a folder in the output folder, with its tracks and
`summary.json`. The folder appears when it is complete, so whatever ends a batch, the same command goes on from there:
it skips the recordings that have results and runs those that failed or never ran. Recordings that have changed since,
and all when the settings change, are run again; their earlier results stay until the new ones take their place.
`report.parquet` has a row for each recording.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from airline.errors import ConfigError
from frontend.batch.job import Job, JobSettings, Row, WorkerDied, run_recording
from frontend.cli.terminal import progress

if TYPE_CHECKING:
    from frontend.cli.settings import RunConfig

__all__ = ["BatchInterrupted", "Row", "run_batch"]

log = logging.getLogger(__name__)

ATTEMPTS = 3  # per recording; a worker's death may be another's fault, as when memory runs out

Submit: TypeAlias = Callable[[Job], Future[Row | WorkerDied]]


class BatchInterrupted(KeyboardInterrupt):
    """Ctrl-C came before the last recording had ended; `rows` are as in the report."""

    def __init__(self, rows: list[Row]) -> None:
        super().__init__()
        self.rows = rows


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

    Args:
        inputs: files, folders or globs: videos, logs, bag folders, image folders.
        out: the folder of all results, made if need be.
        config: settings of each run, see `frontend.cli.settings.load`.
        write: what to write for each recording: "parquet", "mcap", "csv", "limap", "plvins" or "rrd".
        workers: how many recordings run at once on this machine; by default one per two cores.
        ray: run on Ray instead: "local", "auto", "HOST:PORT" or "ray://HOST:PORT".
        overwrite: run recordings that have results, too.

    Returns:
        A row for each recording, as `report.parquet` in `out` holds them.

    Raises:
        AirLineError: an input without a recording, an impossible setting, an output that cannot be written.
        BatchInterrupted: Ctrl-C; the report has been written, and what was finished stays.
    """
    from frontend.batch.plan import REPORT, job_settings, make_plan, reserved, write_report
    from frontend.batch.recordings import find_recordings
    from frontend.cli.settings import RunConfig

    if workers is not None and (workers < 1 or ray is not None):
        raise ConfigError("the number of workers must be 1 or more, and is for this machine, not for Ray")
    settings = job_settings(config or RunConfig(), write)
    report = Path(out) / REPORT
    paths = find_recordings(inputs, Path(out))
    with reserved(Path(out)):
        rows, jobs = make_plan(paths, Path(out).absolute(), settings, overwrite=overwrite)
        try:
            with (
                _executor(workers, ray, settings, len(jobs)) as submit,
                progress("batch", len(jobs), unit="recordings") as advance,
            ):
                write_report(report, rows.values())
                for row in _run_all(jobs, submit):
                    for warning in row.warnings:
                        log.warning("%s", warning if warning.startswith(row.name) else f"{row.name}: {warning}")
                    rows[row.name] = row
                    write_report(report, rows.values())
                    advance()
        except KeyboardInterrupt:
            log.warning("interrupted: what was finished is kept, and the same command goes on from there")
            raise BatchInterrupted(list(rows.values())) from None
    return list(rows.values())


def _run_all(jobs: Sequence[Job], submit: Submit) -> Iterator[Row]:
    """What became of each recording, as it ends; one whose worker dies is run again, after the others."""
    running = {submit(job): (job, 1) for job in jobs}
    while running:
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            job, attempt = running.pop(future)
            try:
                ended = future.result()
            except Exception as error:  # of Ray: a node that is gone, or one without this package
                lines = str(error).strip().splitlines()
                ended = WorkerDied(": ".join(["its worker ended", type(error).__name__, *lines[:1]]).rstrip("."))
            if isinstance(ended, Row):
                yield replace(ended, attempts=attempt)
            elif attempt < ATTEMPTS:
                log.warning("%s: %s; it will be run again", job.name, ended.reason)
                running[submit(job)] = job, attempt + 1
            else:
                reason = f"{ended.reason}, {attempt} times"
                yield Row(job.name, job.input, "failed", reason=reason, attempts=attempt)


@contextmanager
def _executor(workers: int | None, ray: str | None, settings: JobSettings, jobs: int) -> Iterator[Submit]:
    """What starts recordings; at the end of the block, those that still run are ended."""
    if ray is not None and jobs:
        from frontend.batch.ray_cluster import on_ray

        with on_ray(ray, settings) as submit:
            yield submit
        return
    from airline.kernels.threads import cores

    count = max(1, min(jobs, workers or cores() // 2))
    settings = replace(settings, cores=max(1, cores() // count))
    lifeline, our_end = os.pipe()
    pool = ThreadPoolExecutor(count)
    try:
        yield lambda job: pool.submit(run_recording, job, settings, lifeline)
    finally:
        os.close(our_end)
        pool.shutdown(cancel_futures=True)
        os.close(lifeline)

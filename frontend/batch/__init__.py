"""The frontend over many recordings: `python -m frontend.batch 'logs/*.mcap' --out results`.

Each recording is a process of `python -m frontend.run` and gets a folder with its tracks and `summary.json`, which
appears when it is complete: whatever ends a batch, the same command goes on from there. It skips the recordings that
have results, unless they or the settings have changed since; earlier results stay until new ones take their place.
`report.parquet` has a row for each recording.
"""

from __future__ import annotations

import logging
import os
import shutil
import socket
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from filelock import FileLock, Timeout

from airline.errors import ConfigError, InputError, errors_of, from_extra
from frontend.batch.job import UNFINISHED, Job, JobSettings, Row, WorkerDied, run_recording, write_report
from frontend.batch.plan import find_recordings, job_settings, make_plan
from frontend.cli.settings import RunConfig
from frontend.cli.terminal import progress

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
        write: what to write for each recording: "parquet", "mcap", "csv", "limap", "bag", "plvins", "eplf",
            "uvslam" or "rrd".
        workers: how many recordings run at once on this machine; by default one per two cores.
        ray: run on Ray instead: "local", "auto", "HOST:PORT" or "ray://HOST:PORT".
        overwrite: run recordings that have results, too.

    Returns:
        A row for each recording, as `report.parquet` in `out` holds them.

    Raises:
        AirLineError: an input without a recording, an impossible setting, an output that cannot be written.
        BatchInterrupted: Ctrl-C; the report has been written, and what was finished stays.
    """
    if workers is not None and (workers < 1 or ray is not None):
        raise ConfigError("the number of workers must be 1 or more, and is for this machine, not for Ray")
    settings = job_settings(config or RunConfig(), write)
    out = Path(out).absolute()
    paths = find_recordings(inputs, out)
    with reserved(out):
        rows, jobs = make_plan(paths, out, settings, overwrite=overwrite)
        executor = _local(workers, len(jobs), settings) if ray is None or not jobs else _on_ray(ray, settings)
        try:
            with executor as submit, progress("batch", len(jobs), unit="recordings") as advance:
                write_report(out, rows.values())
                for row in _run_all(jobs, submit):
                    for warning in row.warnings:
                        log.warning("%s", warning if warning.startswith(row.name) else f"{row.name}: {warning}")
                    rows[row.name] = row
                    write_report(out, rows.values())
                    advance()
        except KeyboardInterrupt:
            log.warning("interrupted: what was finished is kept, and the same command goes on from there")
            raise BatchInterrupted(list(rows.values())) from None
    return list(rows.values())


@contextmanager
def reserved(out: Path) -> Iterator[None]:
    """The folder of all results, made if need be, for nobody else inside the block, and without unfinished results.

    Raises:
        InputError: it cannot be made or written, or another batch is writing into it.
    """
    lock = FileLock(out / ".lock", timeout=0)  # ends with the process, even with one that is killed
    with errors_of(out):
        out.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire()
        except Timeout:
            raise InputError(f"another batch is writing into '{out}': wait for it, or give another --out") from None
    with lock:
        _remove_unfinished(out)
        try:
            yield
        finally:
            _remove_unfinished(out)


def _remove_unfinished(out: Path) -> None:
    for folder in out.glob(f".*{UNFINISHED}*"):
        shutil.rmtree(folder, ignore_errors=True)


def _run_all(jobs: Sequence[Job], submit: Submit) -> Iterator[Row]:
    """What became of each recording, as it ends; one whose worker dies is run again, after the others."""
    running = {submit(job): (job, 1) for job in jobs}
    while running:
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            job, attempt = running.pop(future)
            try:
                ended = future.result()
            except Exception as error:  # of Ray: a node that is gone, or one without this package
                ended = WorkerDied(f"its worker ended: {_first_line(error)}")
            if isinstance(ended, Row):
                yield replace(ended, attempts=attempt)
            elif attempt < ATTEMPTS:
                log.warning("%s: %s; it will be run again", job.name, ended.reason)
                running[submit(job)] = job, attempt + 1
            else:
                reason = f"{ended.reason}, {attempt} times"
                yield Row(job.name, job.input, "failed", reason=reason, attempts=attempt)


@contextmanager
def _local(workers: int | None, jobs: int, settings: JobSettings) -> Iterator[Submit]:
    """What starts recordings on this machine; at the end of the block, those that still run are ended."""
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


@contextmanager
def _on_ray(address: str, settings: JobSettings) -> Iterator[Submit]:
    """What starts recordings as Ray's tasks, one CPU each; at the end of the block, those that still run are ended.

    "local" starts Ray for this machine alone; the nodes of a cluster have this package, and inputs and results under
    the same paths.

    Raises:
        ConfigError: Ray is not installed.
        InputError: there is no cluster at that address.
    """
    # Ray is told to be quiet and to stay on this machine; what the user has set comes first
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # tasks see the GPU
    os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # a Ray that we start binds to 127.0.0.1
    with from_extra("ray"):
        import ray
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if address == "local":  # with Ray's least object store: rows are all that it carries
        options |= {"include_dashboard": False, "object_store_memory": 80 * 2**20, "_node_ip_address": "127.0.0.1"}
    ours = not ray.is_initialized()
    if ours:
        try:
            if address not in ("local", "auto"):  # where nobody answers Ray itself would try for minutes
                host, _, port = address.removeprefix("ray://").rpartition(":")
                socket.create_connection((host.strip("[]"), int(port)), timeout=10.0).close()
            ray.init(address, **options)
        except (ImportError, OSError, OverflowError, RuntimeError, ValueError) as error:
            addresses = "local, auto, or HOST:PORT or ray://HOST:PORT of a cluster"
            raise InputError(f"cannot use Ray at '{address}' ({_first_line(error)}): give {addresses}") from None
    task = ray.remote(num_cpus=1, max_retries=0)(run_recording)  # Ray's retries would go on for ever without memory
    started = []

    def submit(job: Job) -> Any:
        started.append(task.remote(job, settings))
        return started[-1].future()

    try:
        yield submit
    finally:
        for result in started:
            ray.cancel(result, force=True)  # of no effect on what has ended
        if ours:
            ray.shutdown()


def _first_line(error: Exception) -> str:
    return ": ".join([type(error).__name__, *str(error).strip().splitlines()[:1]]).rstrip(".")

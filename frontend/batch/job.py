"""One recording: run the frontend over it, and let its results appear at once or not at all; and what became of it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Collection
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from airline import __version__
from airline.errors import errors_of
from frontend.cli.settings import RunConfig, dump

OUTPUTS = {
    "parquet": "tracks.parquet",
    "mcap": "tracks.mcap",
    "csv": "tracks.csv",
    "limap": "limap",
    "bag": "plvins.bag",
    "plvins": "plvins.mcap",
    "eplf": "eplf.bag",
    "uvslam": "uvslam.bag",
    "rrd": "recording.rrd",
}
REPORT = "report.parquet"
SUMMARY = "summary.json"
UNFINISHED = ".unfinished-"
MOST_WARNINGS = 20

# `python -m frontend.run`, which ends when nobody holds the other end of its stdin any more: a batch that is killed
# leaves no run behind. (Linux's PR_SET_PDEATHSIG would do the same, but only there.)
_RUN = """
import os, runpy, threading
threading.Thread(target=lambda: (os.read(0, 1), os._exit(1)), daemon=True).start()
runpy.run_module("frontend.run", run_name="__main__", alter_sys=True)
"""


Status = Literal["done", "skipped", "failed", "pending"]


@dataclass(frozen=True)
class JobSettings:
    """What is done with every recording.

    Attributes:
        config: the run's settings, with absolute file names.
        write: keys of `OUTPUTS`.
        made_with: all of it that decides the results, as JSON has it.
        cores: how many cores one recording may keep busy.
    """

    config: RunConfig
    write: tuple[str, ...]
    made_with: dict[str, Any]
    cores: int = 1


@dataclass(frozen=True)
class Job:
    """One recording to be run; `made_from` is its state and the settings, as the summary keeps them."""

    name: str
    input: str  # absolute
    folder: Path  # where its results appear
    made_from: dict[str, Any]


@dataclass(frozen=True)
class Row:
    """What became of one recording.

    Attributes:
        name: of the recording among the others.
        input: absolute path.
        status: "done", "skipped" (done earlier), "failed", or "pending" when the batch was interrupted before it.
        reason: why it failed, in one sentence.
        output: the folder with its results.
        attempts: how often it was started in this batch.
        frames: see `frontend.cli.summary.Summary`, also for the next five.
        seconds: from the start of its process until its results were complete.
        warnings: the first ones that its run gave.
    """

    name: str
    input: str
    status: Status
    reason: str | None = None
    output: str | None = None
    attempts: int = 0
    frames: int | None = None
    skipped_frames: int | None = None
    lines_per_frame: float | None = None
    tracks: int | None = None
    track_length_median: float | None = None
    fps: float | None = None
    seconds: float | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class WorkerDied:
    """A process ended in the middle of a recording; `reason` says how, as in "its worker was killed by SIGKILL"."""

    reason: str


def row_of(job: Job, status: Status, summary: dict[str, Any]) -> Row:
    """The row of a recording that has results, from its summary."""
    known = {field.name: summary[field.name] for field in fields(Row) if field.name in summary}
    known["warnings"] = tuple(known.get("warnings", ()))
    return Row(job.name, job.input, status, output=str(job.folder), **known)


def run_recording(job: Job, settings: JobSettings, lifeline: int = subprocess.PIPE) -> Row | WorkerDied:
    """Run one recording in a process of its own; whatever goes wrong becomes the reason why it failed.

    Results are made in a hidden folder beside `job.folder`, and take its place when they are complete. The process ends
    when the other end of the pipe `lifeline` is closed, by whom or what ever.
    """
    started = time.monotonic()
    warnings: tuple[str, ...] = ()
    hidden, beside = f".{job.name}{UNFINISHED}", job.folder.parent
    try:
        with TemporaryDirectory(prefix=hidden, dir=beside, ignore_cleanup_errors=True) as temporary:
            results = Path(temporary, "results")
            results.mkdir()
            code, said = _run(job, settings, results, lifeline)
            warnings = tuple(line[9:] for line in said if line.startswith("WARNING: "))[:MOST_WARNINGS]
            if code == 0:
                summary = json.loads((results / SUMMARY).read_text(encoding="utf-8"))
                summary |= {"seconds": round(time.monotonic() - started, 3), "warnings": warnings}
                summary |= {"version": __version__, "made_from": job.made_from}
                (results / SUMMARY).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
                if job.folder.exists():
                    job.folder.rename(results.with_name("earlier"))  # never a half-deleted one, should we be killed
                results.rename(job.folder)
                return row_of(job, "done", summary)
        if code < 0:
            name = signal.Signals(-code).name
            return WorkerDied(f"its worker was killed by {name}{' (is there enough memory?)' * (name == 'SIGKILL')}")
        if code > 2:
            return WorkerDied(f"its worker ended by itself with exit code {code}")
        errors = [line.removeprefix("error: ") for line in said if line.startswith("error: ")]
        reason = (errors or said or ["it ended with exit code 1"])[-1]
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
    return Row(job.name, job.input, "failed", reason=reason, warnings=warnings)


def _run(job: Job, settings: JobSettings, folder: Path, lifeline: int) -> tuple[int, list[str]]:
    """Run until the end; the exit code, and the lines on stderr."""
    config = folder.with_name("config.toml")
    config.write_text(dump(settings.config), encoding="utf-8")
    flags = ["--headless", "--config", str(config), "--summary", str(folder / SUMMARY)]
    for kind in settings.write:
        path = folder / OUTPUTS[kind]
        flags += ["--save", str(path)] if kind == "rrd" else ["--out", f"{kind}:{path}"]
    cores = str(settings.cores)
    environment = {
        "OMP_NUM_THREADS": cores,
        "OPENCV_FOR_THREADS_NUM": cores,
        **os.environ,
        "AIRLINE_CORES": cores,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),  # the package that runs here, installed or not
    }
    with subprocess.Popen(
        [sys.executable, "-c", _RUN, job.input, *flags],
        env=environment,
        stdin=lifeline,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="replace",
        start_new_session=True,  # Ctrl-C in a terminal goes to the batch alone, which ends the runs
    ) as process:
        assert process.stderr is not None
        said = [line.strip() for line in process.stderr if line.strip()]
    return process.returncode, said


def write_report(out: Path, rows: Collection[Row]) -> None:
    """Write a row per recording; the file is replaced at once, and complete at any time.

    Raises:
        InputError: it cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {"int": pa.int64(), "float": pa.float64(), "tuple[str, ...]": pa.list_(pa.string())}
    schema = pa.schema([(f.name, kinds.get(str(f.type).removesuffix(" | None"), pa.string())) for f in fields(Row)])
    text = json.dumps([asdict(row) for row in rows], ensure_ascii=False)
    table = json.loads(text.encode("utf-8", "replace"))  # file names may hold bytes that are no text
    path, unfinished = out / REPORT, out / f".{REPORT}.{os.getpid()}"
    try:
        with errors_of(path):
            pq.write_table(pa.Table.from_pylist(table, schema), unfinished)
            unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)

"""One recording: run the frontend over it, and let its results appear at once or not at all."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from frontend.cli.settings import RunConfig

OUTPUTS = {
    "parquet": "tracks.parquet",
    "mcap": "tracks.mcap",
    "csv": "tracks.csv",
    "limap": "limap",
    "plvins": "plvins.mcap",
    "rrd": "recording.rrd",
}
SUMMARY = "summary.json"
UNFINISHED = ".unfinished-"
FIGURES = ("frames", "skipped_frames", "lines_per_frame", "tracks", "track_length_median", "fps", "seconds")
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
        cores: how many cores one recording may keep busy.
    """

    config: RunConfig
    write: tuple[str, ...]
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
    known: dict[str, Any] = {name: summary.get(name) for name in FIGURES}
    warnings = tuple(summary.get("warnings", ()))
    return Row(job.name, job.input, status, output=str(job.folder), warnings=warnings, **known)


def run_recording(job: Job, settings: JobSettings, lifeline: int = subprocess.PIPE) -> Row | WorkerDied:
    """Run one recording in a process of its own; whatever goes wrong becomes the reason why it failed.

    Results are written into a hidden folder beside `job.folder`, which takes its place when they are complete. The
    process ends when the other end of the pipe `lifeline` is closed, by whom or what ever.
    """
    from airline import __version__

    unfinished = job.folder.with_name(f".{job.name}{UNFINISHED}{secrets.token_hex(4)}")
    earlier = unfinished.with_name(f"{unfinished.name}-earlier")
    started = time.monotonic()
    warnings: tuple[str, ...] = ()
    try:
        unfinished.mkdir(parents=True)
        code, said = _run(job, settings, unfinished, lifeline)
        warnings = tuple(line[9:] for line in said if line.startswith("WARNING: "))[:MOST_WARNINGS]
        if code == 0:
            summary = json.loads((unfinished / SUMMARY).read_text(encoding="utf-8"))
            summary |= {"seconds": round(time.monotonic() - started, 3), "warnings": warnings}
            summary |= {"version": __version__, "made_from": job.made_from}
            (unfinished / SUMMARY).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
            if job.folder.exists():
                job.folder.rename(earlier)  # no finished folder either, should we be killed here
            unfinished.rename(job.folder)
            return row_of(job, "done", summary)
        if code not in (1, 2):
            return WorkerDied(_end(code))
        errors = [line.removeprefix("error: ") for line in said if line.startswith("error: ")]
        reason = (errors or said or ["it ended with exit code 1"])[-1]
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
    finally:
        for folder in (unfinished, earlier):
            shutil.rmtree(folder, ignore_errors=True)
    return Row(job.name, job.input, "failed", reason=reason, warnings=warnings)


def _run(job: Job, settings: JobSettings, folder: Path, lifeline: int) -> tuple[int, list[str]]:
    """Run until the end; the exit code, and the lines on stderr."""
    from frontend.cli.settings import dump

    config = folder / "config.toml"
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
    config.unlink()
    return process.returncode, said


def _end(code: int) -> str:
    if code >= 0:
        return f"its worker ended by itself with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"its worker was killed by {name}" + (" (is there enough memory?)" if name == "SIGKILL" else "")

"""One recording: run the frontend over it, and let its results appear at once or not at all."""

from __future__ import annotations

import json
import logging
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from airline.errors import AirLineError

if TYPE_CHECKING:
    from airline.config import DetectorConfig, Runtime
    from airline.detector import AirLine
    from frontend.cli.settings import RunConfig
    from frontend.protocols import Sink

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
_MOST_WARNINGS = 20

Status = Literal["done", "skipped", "failed", "pending"]


@dataclass(frozen=True)
class Recipe:
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
    """One recording to be run.

    Attributes:
        name: of the recording among the others.
        input: absolute path.
        folder: where its results appear.
        made_from: input and settings, as the summary keeps them.
    """

    name: str
    input: str
    folder: Path
    made_from: dict[str, Any]


@dataclass(frozen=True)
class Row:
    """What became of one recording.

    Attributes:
        name, input: of the recording; its absolute path.
        status: "done", "skipped" (done earlier), "failed", or "pending" when the batch was interrupted before it.
        reason: why it failed, in one sentence.
        output: the folder with its results.
        attempts: how often it was started in this batch.
        frames, skipped_frames, lines_per_frame, tracks, track_length_median, fps: see `frontend.cli.summary.Summary`.
        seconds: from opening the recording until its results were complete.
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


def row_of(job: Job, status: Status, summary: dict[str, Any]) -> Row:
    """The row of a recording that has results, from its summary."""
    figures = ("frames", "skipped_frames", "lines_per_frame", "tracks", "track_length_median", "fps", "seconds")
    known: dict[str, Any] = {name: summary.get(name) for name in figures}
    warnings = tuple(summary.get("warnings", ()))
    return Row(job.name, job.input, status, output=str(job.folder), warnings=warnings, **known)


def run_job(job: Job, recipe: Recipe) -> Row:
    """Run one recording; whatever it raises becomes the reason why it failed.

    Results are written into a hidden folder beside `job.folder`, which takes the place of `job.folder` when they are
    complete.
    """
    _settle(recipe.cores)
    unfinished = job.folder.with_name(f".{job.name}{UNFINISHED}{os.getpid()}-{secrets.token_hex(4)}")
    with _gathered_warnings() as warnings:
        try:
            unfinished.mkdir(parents=True)
            summary = _run(job, recipe, unfinished, warnings)
            _publish(unfinished, job.folder)
        except AirLineError as error:
            reason = " ".join(str(error).split())
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
        else:
            return row_of(job, "done", summary)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    return Row(job.name, job.input, "failed", reason=reason, warnings=tuple(warnings))


def _run(job: Job, recipe: Recipe, folder: Path, warnings: list[str]) -> dict[str, Any]:
    """Write all outputs and the summary into the folder; returns the summary."""
    from airline import __version__
    from frontend.cli.summary import SummaryCounter
    from frontend.cli.wiring import open_input, open_recording, open_track_sink, video_to_log
    from frontend.pipeline import LineFrontend, run_pipeline
    from frontend.tracker import LineTracker

    config = recipe.config
    video = video_to_log(job.input, config) if "rrd" in recipe.write else None

    def open_sinks() -> Iterator[Sink]:
        for kind in recipe.write:
            path = folder / OUTPUTS[kind]
            if kind == "rrd":
                yield open_recording(path, None, job.name, config, video)
            else:
                yield open_track_sink(f"{kind}:{path}")

    detector = _detector(config.detector, config.runtime, max(1, recipe.cores // 2))
    frontend = LineFrontend(detector, LineTracker(config.tracker))
    counter = SummaryCounter(config.tracker.confirm_hits)
    started = time.perf_counter()
    source = open_input(job.input, config)
    run_pipeline(source, frontend, open_sinks(), counter, serial=config.serial)
    summary = {
        **counter.summary(source).to_dict(),
        "seconds": round(time.perf_counter() - started, 3),
        "warnings": warnings,
        "version": __version__,
        "made_from": job.made_from,
    }
    (folder / SUMMARY).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return summary


def _publish(unfinished: Path, folder: Path) -> None:
    """Let the results appear, in place of earlier ones."""
    earlier = unfinished.with_name(f"{unfinished.name}-earlier")  # no finished folder either, should we be killed here
    if folder.exists():
        folder.rename(earlier)
    unfinished.rename(folder)
    shutil.rmtree(earlier, ignore_errors=True)


@lru_cache(maxsize=1)
def _detector(config: DetectorConfig, runtime: Runtime, threads: int) -> AirLine:
    """Loaded once per process."""
    from airline.detector import AirLine

    return AirLine(config=config, runtime=runtime, threads=threads)


@cache
def _settle(cores: int) -> None:
    """Keep this process from taking more cores than its share; before torch and OpenCV are loaded."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # as frontend.run does
    os.environ.setdefault("OMP_NUM_THREADS", str(cores))
    import cv2

    cv2.setNumThreads(cores)


@contextmanager
def _gathered_warnings() -> Iterator[list[str]]:
    """Messages of the warnings that are logged inside the block, the first ones."""
    messages: list[str] = []

    class Gather(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if len(messages) < _MOST_WARNINGS:
                messages.append(record.getMessage())

    handler = Gather(logging.WARNING)
    logging.getLogger().addHandler(handler)
    try:
        yield messages
    finally:
        logging.getLogger().removeHandler(handler)

"""What there is to do: which recordings have results already, and where those of the others go."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from airline.errors import InputError
from frontend.cli.settings import RunConfig
from frontend.fleet.inputs import fingerprint
from frontend.fleet.job import SUMMARY, UNFINISHED, Job, Recipe, Row, row_of
from frontend.fleet.names import unique_names

REPORT = "report.parquet"


@dataclass(frozen=True)
class Plan:
    """All recordings, in order.

    Attributes:
        rows: one per recording, "skipped" or "pending".
        jobs: those to be run.
        outdated: how many of them have results of another state of the input, or of other settings.
    """

    rows: list[Row]
    jobs: list[Job]
    outdated: int


def make_plan(paths: Sequence[Path], out: Path, recipe: Recipe, *, overwrite: bool) -> Plan:
    """Compare the recordings with the results that are there.

    A recording that has results keeps its name; the others get names that no folder has. Results count when they were
    made from a file of the same path, size and time of change, with the same settings, be it by an older version of
    this package.

    Args:
        paths: of the recordings, absolute.
        out: the folder of all results.
        recipe: how they are made.
        overwrite: run the recordings that have results, too.
    """
    results = _results(out)
    new = [path for path in paths if str(path) not in results]
    names = unique_names(new, taken=[REPORT, *(entry.name for entry in out.iterdir())])
    settings = _settings(recipe)
    rows: list[Row] = []
    jobs: list[Job] = []
    outdated = 0
    for path in paths:
        name, summary = results.get(str(path)) or (names[path], None)
        made_from = {"input": {"path": str(path), **fingerprint(path)}, **settings}
        job = Job(name, str(path), out / name, made_from)
        if summary is not None and summary["made_from"] == made_from and not overwrite:
            rows.append(row_of(job, "skipped", summary))
        else:
            rows.append(Row(name, str(path), "pending"))
            jobs.append(job)
            outdated += summary is not None and not overwrite
    return Plan(rows, jobs, outdated)


def with_absolute_paths(config: RunConfig) -> RunConfig:
    """The same settings for a process that runs in another folder.

    Raises:
        AirLineError: the calibration or the weights cannot be used: better said once than for every recording.
    """
    from airline.network.weights import BUNDLED, load_weights
    from frontend.camera.calibration import read_calibration

    replace = msgspec.structs.replace
    edges, calib = config.detector.edges, config.input.calib
    if calib is not None:
        read_calibration(calib)
        config = replace(config, input=replace(config.input, calib=str(Path(calib).absolute())))
    if edges.detector == "unet":
        load_weights(edges.weights)
        if edges.weights not in BUNDLED:
            edges = replace(edges, weights=str(Path(edges.weights).absolute()))
            config = replace(config, detector=replace(config.detector, edges=edges))
    return config


@contextmanager
def reserved(out: Path) -> Iterator[None]:
    """The folder of all results, made if need be, for nobody else inside the block, and without unfinished results.

    Raises:
        InputError: it cannot be made or written, or another batch is writing into it.
    """
    from logs.sinks.output import errors_of

    with errors_of(out):
        out.mkdir(parents=True, exist_ok=True)
        lock = (out / ".lock").open("a")
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # ends with the process, even with one that is killed
        except BlockingIOError:
            raise InputError(f"another batch is writing into '{out}': wait for it, or give another --out") from None
        except OSError:  # a file system without locks
            pass
        _remove_unfinished(out)
        try:
            yield
        finally:
            _remove_unfinished(out)


def _remove_unfinished(out: Path) -> None:
    for folder in out.glob(f".*{UNFINISHED}*"):
        shutil.rmtree(folder, ignore_errors=True)


def _results(out: Path) -> dict[str, tuple[str, dict[str, Any]]]:
    """Name and summary of the results that are there, by the path of their recording."""
    found = {}
    for path in sorted(out.glob(f"*/{SUMMARY}")):
        if path.parent.name.startswith("."):
            continue
        try:
            summary = json.loads(path.read_text(encoding="utf-8"))
            found[summary["made_from"]["input"]["path"]] = path.parent.name, summary
        except (OSError, ValueError, LookupError, TypeError):  # not one of ours
            continue
    return found


def _settings(recipe: Recipe) -> dict[str, Any]:
    """All that decides the results but the input, as JSON gives it back."""
    config = recipe.config
    settings = msgspec.to_builtins(config)
    del settings["serial"], settings["input"]["max_latency"]
    if "rrd" not in recipe.write:
        del settings["recording"]
    files = [file for file in (config.input.calib, config.detector.edges.weights) if file and os.path.isabs(file)]  # noqa: PTH117
    made_from = {
        "settings": settings,
        "files": {file: fingerprint(Path(file)) for file in files},
        "write": sorted(recipe.write),
    }
    read_back: dict[str, Any] = json.loads(json.dumps(made_from))
    return read_back

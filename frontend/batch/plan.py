"""What there is to do: which recordings have results already; and what became of all, in a Parquet file."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import shutil
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

import msgspec

from airline.errors import ConfigError, InputError
from frontend.batch.job import OUTPUTS, SUMMARY, UNFINISHED, Job, JobSettings, Row, Status, row_of
from frontend.batch.recordings import fingerprint, unique_names
from frontend.cli.settings import RecordingConfig, RunConfig

log = logging.getLogger(__name__)

REPORT = "report.parquet"
SUMS = ("frames", "tracks", "seconds")


def make_plan(
    paths: Sequence[Path], out: Path, settings: JobSettings, *, overwrite: bool
) -> tuple[dict[str, Row], list[Job]]:
    """Compare the recordings with the results that are there.

    A recording that has results keeps its name; the others get names that no folder has. Results count when they were
    made from a file of the same path, size and time of change, with the same settings, be it by an older version of
    this package. `overwrite` runs the recordings that have results, too.

    Returns:
        A row per recording by its name, in order, "skipped" or "pending"; those to be run.
    """
    results: dict[str, tuple[str, dict[str, Any]]] = {}  # name and summary by the path of the recording
    for file in sorted(out.glob(f"[!.]*/{SUMMARY}")):
        with suppress(OSError, ValueError, LookupError, TypeError):  # not one of ours
            summary = json.loads(file.read_text(encoding="utf-8"))
            results[summary["made_from"]["input"]["path"]] = file.parent.name, summary
    new = [path for path in paths if str(path) not in results]
    names = unique_names(new, taken=[REPORT, *(entry.name for entry in out.iterdir())])
    made_with = _made_with(settings)
    rows: dict[str, Row] = {}
    jobs: list[Job] = []
    outdated = 0
    for path in paths:
        name, summary = results.get(str(path)) or (names[path], {})
        job = Job(name, str(path), out / name, {"input": {"path": str(path), **fingerprint(path)}, **made_with})
        if summary.get("made_from") == job.made_from and not overwrite:
            rows[name] = row_of(job, "skipped", summary)
        else:
            rows[name] = Row(name, str(path), "pending")
            jobs.append(job)
            outdated += bool(summary) and not overwrite
    if outdated:
        log.warning("running again, as input or settings have changed: %d", outdated)
    return rows, jobs


def job_settings(config: RunConfig, write: Sequence[str]) -> JobSettings:
    """The settings of every run, with absolute paths.

    Raises:
        AirLineError: the calibration, the weights or the kinds of output cannot be used: better said once than for
            every recording.
    """
    from airline.network.weights import BUNDLED, load_weights
    from frontend.camera.calibration import read_calibration

    if not write or not OUTPUTS.keys() >= set(write):
        raise ConfigError(f"cannot write {', '.join(write) or 'nothing'}: choose from {', '.join(OUTPUTS)}")
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
    if "rrd" not in write:
        config = replace(config, recording=RecordingConfig())
    return JobSettings(config, tuple(dict.fromkeys(write)))


@contextmanager
def reserved(out: Path) -> Iterator[None]:
    """The folder of all results, made if need be, for nobody else inside the block, and without unfinished results.

    Raises:
        InputError: it cannot be made or written, or another batch is writing into it.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = (out / ".lock").open("a")
    except OSError as error:
        raise InputError(f"cannot write '{out}': {error.strerror or error}") from error
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


def _made_with(settings: JobSettings) -> dict[str, Any]:
    """All that decides the results but the input, as JSON gives it back."""
    values = msgspec.to_builtins(settings.config)
    del values["serial"], values["input"]["max_latency"]
    if "rrd" not in settings.write:
        del values["recording"]
    files = [values["input"]["calib"], values["detector"]["edges"]["weights"]]
    prints = {file: fingerprint(Path(file)) for file in files if file and os.path.isabs(file)}  # noqa: PTH117
    made_with = {"settings": values, "files": prints, "write": sorted(settings.write)}
    return dict(json.loads(json.dumps(made_with)))


def write_report(path: Path, rows: Collection[Row]) -> None:
    """Write a row per recording; the file is replaced at once, and complete at any time.

    Raises:
        InputError: it cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    text, whole, real = pa.string(), pa.int64(), pa.float64()
    kinds = dict.fromkeys(("attempts", "frames", "skipped_frames", "tracks"), whole)
    kinds |= dict.fromkeys(("lines_per_frame", "track_length_median", "fps", "seconds"), real)
    kinds |= {"warnings": pa.list_(text)}
    schema = pa.schema([(name, kinds.get(name, text)) for name in Row.__dataclass_fields__])
    table = [{name: _printable(value) for name, value in asdict(row).items()} for row in rows]
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        pq.write_table(pa.Table.from_pylist(table, schema), unfinished)
        unfinished.replace(path)
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from error
    finally:
        unfinished.unlink(missing_ok=True)


def summary_lines(rows: Collection[Row]) -> list[str]:
    """What became of how many recordings, and the reasons of those that failed."""
    lines = []
    for status in get_args(Status):
        found = [row for row in rows if row.status == status]
        if found:
            frames, tracks, seconds = (sum(getattr(row, name) or 0 for row in found) for name in SUMS)
            lines.append(f"{status}: {len(found)} recordings, {frames} frames, {tracks} tracks, {seconds:.1f} s")
    return lines + [_printable(f"failed {row.name}: {row.reason}") for row in rows if row.status == "failed"]


def _printable(value: Any) -> Any:
    """File names, and what tells of them, may hold bytes that are no text."""
    if isinstance(value, tuple):
        return [_printable(entry) for entry in value]
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value

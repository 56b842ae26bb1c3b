"""What there is to do: which recordings are meant, what their results are called, and which have them already."""

from __future__ import annotations

import glob
import hashlib
import json
import logging
import os
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from airline.errors import AirLineError, ConfigError, InputError
from frontend.batch.job import OUTPUTS, REPORT, SUMMARY, Job, JobSettings, Row, row_of
from frontend.cli.settings import InputConfig, RunConfig

log = logging.getLogger(__name__)

_LONGEST = 150  # bytes; file systems allow 255, and an unfinished folder's name is longer


def find_recordings(patterns: Iterable[str | os.PathLike[str]], out: Path) -> list[Path]:
    """Absolute paths of the recordings that files, folders and globs name, each once, those of a glob in natural order.

    What lies in the folder `out` of the results, or holds it, is no recording.

    Raises:
        InputError: a pattern without a recording.
    """
    from natsort import natsorted

    found: dict[Path, None] = {}
    results = out.resolve()
    for pattern in patterns:
        expanded = os.path.expanduser(os.fspath(pattern))  # noqa: PTH111  a quoted pattern comes with its ~
        matches = [expanded] if os.path.lexists(expanded) else natsorted(glob.glob(expanded, recursive=True))  # noqa: PTH207
        if not matches:
            raise InputError(f"there is no recording '{pattern}': give files, folders or globs of recordings")
        real = {match: Path(match).resolve() for match in matches}
        kept = [m for m, path in real.items() if not (path.is_relative_to(results) or results.is_relative_to(path))]
        if not kept:
            raise InputError(f"'{pattern}' is where the results go: give another --out")
        found.update(dict.fromkeys(Path(os.path.abspath(match)) for match in kept))  # noqa: PTH100  keeps links
    return list(found)


def fingerprint(path: Path) -> dict[str, int]:
    """Size in bytes and time of the last change in ns of a file, or of all files in a folder; zeros for none."""
    files = [path]
    if path.is_dir():
        files = [Path(folder, name) for folder, _, names in os.walk(path) for name in names]
    stats = [file.stat() for file in files if file.exists()]  # a broken link: opening it will tell
    return {
        "bytes": sum(stat.st_size for stat in stats),
        "modified_ns": max((stat.st_mtime_ns for stat in stats), default=0),
    }


def unique_names(paths: Iterable[Path], taken: Iterable[str] = ()) -> dict[Path, str]:
    """A folder name for each recording: as short as is distinct, whatever their order.

    `a/x.mcap` becomes `x`; beside `b/x.mcap` it becomes `a-x`, beside `a/x.bag` `x.mcap`; where both are there it is a
    digest. Names differ by more than upper and lower case, also from those that are `taken`.
    """
    choices = {}
    for path in paths:
        stem = path.name if path.is_dir() else path.stem
        joined = ["-".join((*path.parts[-1 - depth : -1], stem)) for depth in range(1, len(path.parts))]
        # no hidden folder, and only characters that can be printed and stored
        names = [name.encode("utf-8", "replace").decode().replace("/", "") for name in (stem, *joined, path.name)]
        names = [name.lstrip(".") or "recording" for name in names if len(name.encode()) <= _LONGEST]
        choices[path] = [*names, f"recording-{hashlib.sha256(os.fsencode(path)).hexdigest()}"]
    claims = Counter(key for names in choices.values() for key in set(map(_key, names)))
    claims.update(2 * [*map(_key, taken)])
    return {path: next((n for n in names if claims[_key(n)] == 1), names[-1]) for path, names in choices.items()}


def _key(name: str) -> str:
    """What two names have in common that some file system takes for one."""
    return unicodedata.normalize("NFC", name.casefold())


def job_settings(config: RunConfig, write: Sequence[str]) -> JobSettings:
    """The settings of every run, with absolute paths.

    Raises:
        AirLineError: the calibration, the weights or the kinds of output cannot be used: better said once than for
            every recording.
    """
    from airline.network.weights import BUNDLED, load_weights
    from frontend.camera.calibration import read_calibration
    from frontend.cli.wiring import check_points

    if not write or not OUTPUTS.keys() >= set(write):
        raise ConfigError(f"cannot write {', '.join(write) or 'nothing'}: choose from {', '.join(OUTPUTS)}")
    for kind in write:
        check_points(kind, config.tracker.points)
    values: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(config))
    chosen, edges = values["input"], values["detector"]["edges"]
    files: dict[str, dict[str, int]] = {}

    def own(table: dict[str, Any], key: str) -> None:
        table[key] = str(Path(table[key]).absolute())
        files[table[key]] = fingerprint(Path(table[key]))

    if config.input.right is not None:
        raise ConfigError("--right is of one recording: give --stereo, which takes what lies beside each")
    for key, file in (("calib", config.input.calib_file), ("right_calib", config.input.right_calib)):
        if file is not None:
            read_calibration(file)
            own(chosen, key)
    if edges["detector"] == "unet":
        load_weights(edges["weights"])
        if edges["weights"] not in BUNDLED:
            own(edges, "weights")
    if "rrd" not in write:
        del values["recording"]
    config = msgspec.convert(values, RunConfig)
    del values["serial"], chosen["max_latency"]  # of no effect on the results
    made_with = {"settings": values, "files": files, "write": sorted(write)}
    return JobSettings(config, tuple(dict.fromkeys(write)), made_with)


def make_plan(
    paths: Sequence[Path], out: Path, settings: JobSettings, *, overwrite: bool
) -> tuple[dict[str, Row], list[Job]]:
    """Compare the recordings with the results that are there.

    A recording that has results keeps its name; the others get names that no folder has. Results count when they were
    made from the same state of the same file with the same settings, by any version; with `overwrite` none do.

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
    rows: dict[str, Row] = {}
    jobs: list[Job] = []
    outdated = 0
    for path in paths:
        name, summary = results.get(str(path)) or (names[path], {})
        made_from = {"input": {"path": str(path), **fingerprint(path)}, **settings.made_with}
        beside = {str(file): fingerprint(file) for file in _beside(path, settings.config.input)}
        if beside:
            made_from["files"] = {**made_from["files"], **beside}
        job = Job(name, str(path), out / name, made_from)
        if summary.get("made_from") == job.made_from and not overwrite:
            rows[name] = row_of(job, "skipped", summary)
        else:
            rows[name] = Row(name, str(path), "pending")
            jobs.append(job)
            outdated += bool(summary) and not overwrite
    if outdated:
        log.warning("running again, as input or settings have changed: %d", outdated)
    return rows, jobs


def _beside(path: Path, settings: InputConfig) -> list[Path]:
    """What a run takes by itself that need not be in the recording: the right camera, and calibration files."""
    from frontend.camera.layouts import calibration_beside
    from frontend.sources.listing import folder_of, list_images
    from frontend.sources.pairs import find_pair

    found: list[Path] = []
    with suppress(AirLineError, OSError):  # not images, or none that can be read: opening it will tell
        cameras = [Path(camera) for camera in find_pair(str(path))] if settings.stereo else [path]
        found += cameras[1:]
        for camera in cameras if settings.calib is None else ():
            place = folder_of(list_images(camera, settings.fps).rows)
            if place is not None and (file := calibration_beside(place)) is not None:
                found.append(file)
    return found

"""The command line, inside this process or in one of its own, and what it recorded, read back."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from frontend.run import main

ROOT = Path(__file__).parents[2]
EVERY_FRAME = {
    *(f"/camera/{name}" for name in ("image", "edges", "orientation", "regions", "segments")),
    *(f"/camera/{name}" for name in ("tracks", "tracks/rest", "tracks/lost", "tails")),
    *(f"/stats/{plot}" for plot in ("counts", "time_ms", "track_length")),
}


@dataclass(frozen=True)
class Outcome:
    """Exit code and everything printed."""

    code: int | str | None
    out: str
    err: str


def command(*arguments: object, main: Callable[[list[str]], int] = main) -> Outcome:
    """A command line, `frontend.run` or another, here; under pytest, log lines go to `caplog` and not to stderr."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code: int | str | None = main([str(argument) for argument in arguments])
        except SystemExit as stop:  # argparse
            code = stop.code
    return Outcome(code, out.getvalue(), err.getvalue())


def refusal(*arguments: object, main: Callable[[list[str]], int] = main) -> str:
    """The one sentence with which a command line is refused before it prints anything but what the input is."""
    outcome = command(*arguments, main=main)
    assert outcome.code == 2, outcome
    begin = ("input: ", "calibration: ", "stereo: ", "writing: ", "note: ")
    assert all(line.startswith(begin) for line in outcome.out.splitlines()), outcome
    assert re.fullmatch(r"error: .{1,500}\n", outcome.err), outcome.err
    return outcome.err.removeprefix("error: ").rstrip("\n")


def python(*arguments: object, module: str = "frontend.run", **options: Any) -> subprocess.Popen[str]:
    """Start a command line in a process of its own, with SIGINT as in a foreground job of a shell, stdout buffered."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "100"}
    environment.pop("PYTHONUNBUFFERED", None)
    start = "import runpy, signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    start += f"runpy.run_module('{module}', run_name='__main__', alter_sys=True)"
    return subprocess.Popen([sys.executable, "-c", start, *map(str, arguments)], env=environment, text=True, **options)


def recorded(path: Path) -> dict[str, dict[str, list[Any]]]:
    """Columns of every entity of a recording, rows in order of `frame`, times in ns."""
    from rerun.chunk import RrdReader

    entities: dict[str, dict[str, list[Any]]] = {}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*footer")  # of a recording that somebody killed
        chunks = RrdReader(path).stream().to_chunks()
    for chunk in chunks:
        columns = entities.setdefault(chunk.entity_path, {})
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            is_time = str(column.type) in ("duration[ns]", "timestamp[ns]")
            columns.setdefault(name, []).extend((column.cast("int64") if is_time else column).to_pylist())
    for columns in entities.values():
        if "frame" in columns:
            order = sorted(range(len(columns["frame"])), key=columns["frame"].__getitem__)
            columns.update(
                {name: [rows[k] for k in order] for name, rows in columns.items() if len(rows) == len(order)}
            )
    return entities


def seen_tracks(entities: dict[str, dict[str, list[Any]]]) -> dict[str, list[Any]]:
    """Columns of all tracks that were seen, frame by frame in the order of their ids."""
    shown, rest = entities["/camera/tracks"], entities["/camera/tracks/rest"]
    assert shown["frame"] == rest["frame"]
    columns = {"frame": shown["frame"], "sensor_time": shown["sensor_time"]}
    for name in ("track_id", "measured", "LineStrips2D:strips", "LineStrips2D:colors"):
        columns[name] = []
        for k in range(len(shown["frame"])):
            both = zip(shown["track_id"][k] + rest["track_id"][k], shown[name][k] + rest[name][k], strict=True)
            columns[name].append([value for _, value in sorted(both, key=lambda pair: pair[0])])
    return columns


def curve(entities: dict[str, dict[str, list[Any]]], plot: str, name: str) -> list[float]:
    """The values of a curve."""
    columns = entities[f"/stats/{plot}"]
    ((*names,),) = (row for row in columns["SeriesLines:names"] if row)
    return [row[names.index(name)] for row in columns["Scalars:scalars"] if row]


def read_screen(control: int, watch: Callable[[bytes], None] = lambda screen: None) -> str:
    """All that is written to a pseudo-terminal until nobody holds it, without control codes; closes `control`.

    `watch` is called with the raw screen so far after every part.
    """
    screen = b""
    with suppress(OSError):  # how Linux says that nobody holds the terminal any more
        while part := os.read(control, 4096):
            screen += part
            watch(screen)
    os.close(control)
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", screen.decode())

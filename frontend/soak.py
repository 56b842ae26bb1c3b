"""Does it hold out? `python -m frontend.soak` runs a clip over and over, and watches memory, time, order and ids.

The whole pipeline runs, with tracks into MCAP and everything into Rerun. Both recordings begin anew every so many
frames, in a few files that are overwritten in turn, so that a run of any length needs little room; every finished MCAP
file is read back.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from airline.command import Parser, write_json
from airline.config import PRESETS, RUNTIMES
from airline.errors import AirLineError, ConfigError, InputError
from frontend.evaluation.endurance import Endurance, Trend, trend

if TYPE_CHECKING:
    from rich.table import Table

    from frontend.protocols import FrameResult, Sink

EXIT_VIOLATION = 1
WARM_UP = 0.25  # part of a run in which it may still grow: caches, arenas of the allocator, the clip's first turn
SAMPLES = 200
SHORTEST = 5  # frames per sample
LEAST_FRAMES = 120
GROWTH_MB = 16.0  # what may be certain of growth; 330 bytes per frame over 50,000 frames
SLOWER = 0.1  # part of the time per frame by which it may certainly grow


class Turns:
    """Records into a few files in turn; a `Sink`.

    Args:
        folder: where `soak-0.mcap`, `soak-0.rrd`, `soak-1.mcap`, ... go; what is there is overwritten.
        frames: per file.
        files: how many there are of each kind.

    Attributes:
        finished: files of each kind that have been completed.
        faults: what was wrong with the MCAP files when they were read back.
    """

    def __init__(self, folder: Path, frames: int, files: int) -> None:
        self.finished = 0
        self.faults: list[str] = []
        self._folder, self._frames, self._files = folder, frames, files
        self._sinks: list[Sink] = []
        self._indices: list[int] = []

    def write(self, result: FrameResult) -> None:
        """Record one frame."""
        if len(self._indices) == self._frames:
            self.close()
        if not self._sinks:
            self._open()
        for sink in self._sinks:
            sink.write(result)
        self._indices.append(result.tracks.frame_index)

    def close(self) -> None:
        """Finish the files at hand and read the tracks back."""
        from logs import read_tracks

        while self._sinks:
            self._sinks.pop().close()
        if self._indices:
            path = self._path(".mcap")
            if [tracks.frame_index for tracks in read_tracks(path)] != self._indices:
                self.faults.append(f"{path.name}, file {self.finished}, does not hold its frames")
            self._indices = []
            self.finished += 1

    def _open(self) -> None:
        from logs.sinks.mcap_tracks import McapTrackSink
        from viz.rerun_sink import RerunSink

        self._sinks.append(McapTrackSink(self._path(".mcap"), overwrite=True))
        self._sinks.append(RerunSink(save=self._path(".rrd"), name="soak"))

    def _path(self, suffix: str) -> Path:
        return self._folder / f"soak-{self.finished % self._files}{suffix}"


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m frontend.soak",
        description="Run a clip over and over through the whole pipeline; exit code 1 if anything grows or goes wrong.",
    )
    parser.add_argument("input", nargs="?", help="whatever frontend.run takes (default: the built-in clip)")
    parser.add_argument("--frames", type=int, default=50_000, metavar="N", help="in all (default: %(default)s)")
    parser.add_argument("--size", default="640x480", metavar="WxH", help="of the frames (default: %(default)s)")
    parser.add_argument("--preset", choices=PRESETS, default="default")
    parser.add_argument("--runtime", choices=RUNTIMES, default="auto")
    parser.add_argument(
        "--per-file", type=int, default=1000, metavar="N", help="frames per file (default: %(default)s)"
    )
    parser.add_argument("--files", type=int, default=3, metavar="N", help="files in turn (default: %(default)s)")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="for the files (default: a temporary one)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write figures and samples as JSON")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code: 0, 1 for a violation, 2 for errors a user can mend, 130 after Ctrl-C."""
    options = build_parser().parse_args(arguments)
    try:
        return run(options)
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def run(options: argparse.Namespace) -> int:
    """Run, print the table and write the JSON; returns the exit code.

    Raises:
        AirLineError: an argument or the input cannot be used.
    """
    if options.frames < LEAST_FRAMES or options.per_file < 1 or options.files < 1:
        raise ConfigError(f"--frames must be {LEAST_FRAMES} or more, --per-file and --files 1 or more")
    for folder in (options.folder, options.json and options.json.parent):
        if folder is not None and not folder.is_dir():
            raise InputError(f"no folder {folder}: create it, or name another")
    from rich.console import Console

    from frontend.bench import ClipSource, load_clips
    from frontend.cli.settings import load
    from frontend.run import process

    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # as frontend.run does
    config = load(None, {"preset": options.preset, "runtime": options.runtime, "input": {"max_frames": 120}})
    clip = ClipSource(load_clips(options.input, [options.size], config)[options.size], options.frames, "soak")
    watch = Endurance(max(SHORTEST, options.frames // SAMPLES))
    with tempfile.TemporaryDirectory(prefix="soak-") as temporary:
        turns = Turns(options.folder or Path(temporary), options.per_file, options.files)

        def open_sinks() -> Iterator[Sink]:
            yield watch
            yield turns

        code, summary = process(clip, config, open_sinks())
    if code not in (0, 130):
        return code
    figures = judge(watch, turns)
    Console().print(table(figures, watch, turns, summary.fps))
    for fault in figures["faults"]:
        print(f"violation: {fault}", file=sys.stderr)
    samples = {"memory_mb": watch.memory_mb, "cpu_ms": watch.cpu_ms, "handles": watch.handles}
    write_json(options.json, {"size": options.size, "preset": options.preset, **figures, "samples": samples})
    return code or (EXIT_VIOLATION if figures["faults"] else 0)


def judge(watch: Endurance, turns: Turns) -> dict[str, Any]:
    """All figures of a run, and what was wrong with it."""
    faults = [*watch.faults, *turns.faults]
    memory, cpu = (_trend(values) for values in (watch.memory_mb, watch.cpu_ms))
    handles = watch.handles[len(watch.handles) // 4 :]
    if memory is not None and memory.least > GROWTH_MB:
        faults.append(f"memory grew by {memory.change:.1f} ± {memory.margin:.1f} MB, more than {GROWTH_MB:g}")
    if cpu is not None and cpu.least > SLOWER * cpu.mean:
        faults.append(f"the time per frame grew by {cpu.change:.2f} ± {cpu.margin:.2f} ms of {cpu.mean:.2f}")
    third = max(1, len(handles) // 3)
    if handles and min(handles[-third:]) > max(handles[:third]):
        faults.append(f"open files and threads went from {handles[0]} to {handles[-1]}")
    return {
        "frames": watch.frames,
        "tracks": watch.tracks,
        "files": turns.finished,
        "memory_mb": None if memory is None else asdict(memory),
        "cpu_ms": None if cpu is None else asdict(cpu),
        "handles": [min(handles), max(handles)] if handles else None,
        "faults": faults,
    }


def table(figures: dict[str, Any], watch: Endurance, turns: Turns, fps: float) -> Table:
    """The figures for the terminal."""
    from rich.table import Table

    shown = Table(show_header=False)
    shown.add_row("frames, in order", f"{watch.frames}")
    shown.add_row("frames/s", f"{fps:.1f}")
    shown.add_row("track ids, none used twice", f"{watch.tracks}")
    shown.add_row("files of each kind, read back", f"{turns.finished}")
    for title, key in (("memory, MB", "memory_mb"), ("processor time per frame, ms", "cpu_ms")):
        if figures[key] is not None:
            found = Trend(**figures[key])
            change = f"change {found.change:+.2f} ± {found.margin:.2f}, noise {found.noise:.2f}"
            shown.add_row(title, f"{found.mean:.1f}; {change}")
    if figures["handles"]:
        shown.add_row("open files and threads", "{} to {}".format(*figures["handles"]))
    shown.add_row("violations", f"{len(figures['faults'])}")
    return shown


def _trend(values: list[float]) -> Trend | None:
    """The trend behind the warm-up; None where there is too little, or nothing that is known."""
    settled = np.array(values[round(WARM_UP * len(values)) :])
    return trend(settled) if len(settled) >= 30 and np.isfinite(settled).all() else None


if __name__ == "__main__":
    sys.exit(main())

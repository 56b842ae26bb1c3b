"""Does it hold out? `python -m tests.helpers.soak` runs a clip over and over, and watches memory, time, order and ids.

The whole pipeline runs, with tracks into MCAP and everything into Rerun. Both recordings begin anew every so many
frames, in a few files that are overwritten in turn, so that a run of any length needs little room; every finished MCAP
file is read back.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from airline.command import Parser, image_size, number, write_json
from airline.config import PRESETS, RUNTIMES
from airline.errors import AirLineError, InputError
from frontend.bench import ClipSource, load_clips, memory_mb

if TYPE_CHECKING:
    from frontend.protocols import FrameResult, Sink
    from frontend.tracks import LineTracks

EXIT_VIOLATION = 1
WARM_UP = 0.25  # part of a run in which it may still grow: caches, arenas of the allocator, the clip's first turn
SAMPLES = 200
SHORTEST = 5  # frames per sample
LEAST_FRAMES = 120
GROWTH_MB = 16.0  # what may be certain of growth; 330 bytes per frame over 50,000 frames
SLOWER = 0.1  # part of the time per frame by which it may certainly grow
BLOCKS = 20  # samples follow each other too closely to count each; medians of so many blocks do not
TRENDS = ("memory_mb", "cpu_ms")
T_95 = 2.101  # Student's t for 18 degrees of freedom, two-sided


class Trend(NamedTuple):
    """How a figure changes along a run.

    Attributes:
        mean: of all samples.
        noise: standard deviation of the samples about the trend.
        change: by how much the trend's line rises from the first to the last sample.
        margin: half the width of its 95 % confidence interval.
    """

    mean: float
    noise: float
    change: float
    margin: float


def trend(samples: Sequence[float]) -> Trend:
    """The line through equally spaced samples behind the warm-up, its confidence by the scatter of block medians.

    All is NaN where they are too few, as after Ctrl-C, or where the system did not say.
    """
    values = np.array(samples[round(WARM_UP * len(samples)) :], np.float64)
    if len(values) < 30:
        return Trend(*[np.nan] * 4)
    place = np.linspace(-0.5, 0.5, len(values))
    blocks = np.array([[np.median(part) for part in np.array_split(v, BLOCKS)] for v in (place, values)])
    x, y = blocks[0] - blocks[0].mean(), blocks[1] - blocks[1].mean()
    slope = float(x @ y / (x @ x))
    error = float(np.sqrt(((y - slope * x) ** 2).sum() / (BLOCKS - 2) / (x @ x)))
    noise = float(np.std(values - values.mean() - slope * (place - place.mean())))
    return Trend(float(values.mean()), noise, slope, T_95 * error)


class Endurance:
    """Watches every frame of a run, in constant memory but for the samples; a `Sink`.

    Args:
        every: frames per sample.

    Attributes:
        faults: what must not happen and did, one sentence each; at most twenty are kept.
        frames: so far.
        tracks: ids so far.
        memory_mb: resident memory at every sample.
        cpu_ms: processor time per frame of this process, all threads, over every sample.
        handles: open files and threads at every sample.
    """

    def __init__(self, every: int) -> None:
        self.faults: list[str] = []
        self.frames = self.tracks = 0
        self.memory_mb: list[float] = []
        self.cpu_ms: list[float] = []
        self.handles: list[int] = []
        self._every = every
        self._next_index = 0
        self._last_ns: int | None = None
        self._highest = -1
        self._alive: set[int] = set()
        self._cpu_s = time.process_time()

    def write(self, result: FrameResult) -> None:
        """Check one frame, and take a sample when it is time."""
        tracks = result.tracks
        if tracks.frame_index != self._next_index:
            self._fault(f"frame {tracks.frame_index} came where frame {self._next_index} was due")
        if self._last_ns is not None and tracks.stamp_ns <= self._last_ns:
            self._fault(f"the time of frame {tracks.frame_index} is not later than that of the one before")
        self._next_index, self._last_ns = tracks.frame_index + 1, tracks.stamp_ns
        self._check_ids(tracks)
        self.frames += 1
        if self.frames % self._every == 0:
            self.cpu_ms.append(1e3 * (time.process_time() - self._cpu_s) / self._every)
            self.memory_mb.append(resident_mb())
            files = Path("/proc/self/fd")
            self.handles.append(threading.active_count() + (len(list(files.iterdir())) if files.exists() else 0))
            self._cpu_s = time.process_time()

    def close(self) -> None:
        """Nothing is open."""

    def _check_ids(self, tracks: LineTracks) -> None:
        """New ids are higher than all before; others are alive; what has ended does not come back."""
        ids = tracks.ids.tolist()
        seen = set(ids)
        if len(seen) != len(ids):
            self._fault(f"frame {tracks.frame_index} has a track id twice")
        if tracks.reset is not None:
            self._alive.clear()
        old = {track for track in seen if track <= self._highest}
        if not old <= self._alive:
            self._fault(f"frame {tracks.frame_index} uses track id {min(old - self._alive)} again")
        self.tracks += len(seen) - len(old)
        self._highest = max(self._highest, *seen) if seen else self._highest
        self._alive |= seen
        self._alive -= set(tracks.ended_ids.tolist())

    def _fault(self, text: str) -> None:
        if len(self.faults) < 20:
            self.faults.append(text)


class Turns:
    """Records into a few files of so many frames in turn: `soak-0.mcap`, `soak-0.rrd`, `soak-1.mcap`, ...; a `Sink`.

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
        from frontend.cli.settings import RunConfig
        from frontend.cli.wiring import open_recording, open_track_sink

        if len(self._indices) == self._frames:
            self.close()
        if not self._sinks:
            self._sinks.append(open_track_sink(str(self._path(".mcap")), overwrite=True))
            self._sinks.append(open_recording(self._path(".rrd"), None, "soak", RunConfig()))
        for sink in self._sinks:
            sink.write(result)
        self._indices.append(result.tracks.frame_index)

    def close(self) -> None:
        """Finish the files at hand and read the tracks back."""
        from frontend.cli.wiring import read_tracks

        while self._sinks:
            self._sinks.pop().close()
        if self._indices:
            path = self._path(".mcap")
            if [tracks.frame_index for tracks in read_tracks(path)] != self._indices:
                self.faults.append(f"{path.name}, file {self.finished}, does not hold its frames")
            self._indices = []
            self.finished += 1

    def _path(self, suffix: str) -> Path:
        return self._folder / f"soak-{self.finished % self._files}{suffix}"


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m tests.helpers.soak",
        description="Run a clip over and over through the whole pipeline; exit code 1 if anything grows or goes wrong.",
    )
    parser.add_argument("input", nargs="?", help="whatever frontend.run takes (default: the built-in clip)")
    add = parser.add_argument
    add("--frames", type=number(int, LEAST_FRAMES), default=50_000, metavar="N", help="in all (default: %(default)s)")
    add("--size", type=image_size, default="640x480", metavar="WxH", help="of the frames (default: %(default)s)")
    add("--preset", choices=PRESETS, default="default")
    add("--runtime", choices=RUNTIMES, default="auto")
    add("--per-file", type=number(int, 1), default=1000, metavar="N", help="frames per file (default: %(default)s)")
    add("--files", type=number(int, 1), default=3, metavar="N", help="files in turn (default: %(default)s)")
    add("--folder", type=Path, metavar="DIR", help="for the files (default: a temporary one)")
    parser.add_json()
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
    from rich.console import Console
    from rich.table import Table

    from frontend.cli.settings import load
    from frontend.run import process

    if options.folder is not None and not options.folder.is_dir():
        raise InputError(f"no folder {options.folder}: create it, or name another")
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # as frontend.run does
    config = load(None, {"preset": options.preset, "runtime": options.runtime, "input": {"max_frames": 120}})
    ((size, (files, _)),) = load_clips(options.input, [options.size], config).items()
    watch = Endurance(max(SHORTEST, options.frames // SAMPLES))
    with tempfile.TemporaryDirectory(prefix="soak-") as temporary:
        turns = Turns(options.folder or Path(temporary), options.per_file, options.files)
        code, summary = process(ClipSource(files, options.frames, name="soak"), config, [watch, turns])
    if code not in (0, 130):
        return code
    figures = judge(watch, turns)
    table = Table(show_header=False)
    for name, value in {"frames/s": summary.fps, **figures}.items():
        table.add_row(name, ", ".join(f"{part} {v:.2f}" for part, v in value.items()) if name in TRENDS else f"{value}")
    Console().print(table)
    for fault in figures["faults"]:
        print(f"violation: {fault}", file=sys.stderr)
    samples = {"memory_mb": watch.memory_mb, "cpu_ms": watch.cpu_ms, "handles": watch.handles}
    write_json(options.json, {"size": size, "preset": options.preset, **figures, "samples": samples})
    return code or (EXIT_VIOLATION if figures["faults"] else 0)


def judge(watch: Endurance, turns: Turns) -> dict[str, Any]:
    """All figures of a run, and what was wrong with it."""
    faults = [*watch.faults, *turns.faults]
    memory, cpu = trend(watch.memory_mb), trend(watch.cpu_ms)
    handles = watch.handles[round(WARM_UP * len(watch.handles)) :]
    if memory.change - memory.margin > GROWTH_MB:
        faults.append(f"memory grew by {memory.change:.1f} ± {memory.margin:.1f} MB, more than {GROWTH_MB:g}")
    if cpu.change - cpu.margin > SLOWER * cpu.mean:
        faults.append(f"the time per frame grew by {cpu.change:.2f} ± {cpu.margin:.2f} ms of {cpu.mean:.2f}")
    third = max(1, len(handles) // 3)
    if handles and min(handles[-third:]) > max(handles[:third]):
        faults.append(f"open files and threads went from {handles[0]} to {handles[-1]}")
    return {
        "frames": watch.frames,
        "tracks": watch.tracks,
        "files": turns.finished,
        "memory_mb": memory._asdict(),
        "cpu_ms": cpu._asdict(),
        "handles": [min(handles), max(handles)] if handles else None,
        "faults": faults,
    }


def resident_mb() -> float:
    """Memory of this process in MB, garbage collected first; NaN where the system does not say."""
    gc.collect()
    return memory_mb("VmRSS")


if __name__ == "__main__":
    sys.exit(main())

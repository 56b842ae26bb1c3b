"""How fast the whole pipeline is, with and without sinks, in series and overlapped: `python -m frontend.bench`.

Frames are held in memory as JPEG files: every run decodes them, and none waits for a disk or for the rendering of the
built-in clip. Every run has a process of its own, and the runs take turns.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airline.command import Parser, exit_code, image_size, number, write_json
from airline.config import PRESETS, RUNTIMES
from airline.errors import InputError
from frontend.cli.terminal import progress
from frontend.frame import Frame
from frontend.protocols import Source

if TYPE_CHECKING:
    from rich.table import Table

    from frontend.cli.settings import RunConfig
    from frontend.protocols import Sink

SIZES = ((640, 480), (752, 480), (1280, 720), (1920, 1080))
CLIP_FRAMES = 120  # held in memory; longer runs go through them forth and back
ROUNDS = 2
JPEG_QUALITY = 95
PERIOD_NS = 33_333_333
LSD_FRAMES = 10

Figures = dict[str, Any]
RUNS = {  # sink, and whether in series
    "fps_serial": ("none", True),
    "fps": ("none", False),
    "fps_rerun_serial": ("rerun", True),
    "fps_rerun": ("rerun", False),
    "fps_mcap": ("mcap", False),
    "fps_pairs": ("none", False),  # with --stereo, beside `fps` in all else
}
ROWS = {
    "fps_serial": "frames/s in series",
    "fps": "frames/s",
    "fps_rerun_serial": "frames/s into Rerun, in series",
    "fps_rerun": "frames/s into Rerun",
    "fps_mcap": "frames/s into MCAP",
    "fps_pairs": "pairs/s",
    "pair_cost": "time of a pair over that of an image",
    "latency_ms": "latency, ms",
    "peak_mb": "peak MB over torch",
    "peak_mb_rerun": "peak MB over torch, with Rerun",
    "peak_mb_pairs": "peak MB over torch, of pairs",
    "lines": "lines",
    "lsd_ms": "OpenCV LSD, ms",
}


@dataclass(frozen=True)
class ClipSource(Source):
    """Decodes a short clip, JPEG files of one size, forth and back until there are `frame_count` frames.

    With files of a right camera frames are pairs.
    """

    files: Sequence[bytes]
    frame_count: int
    right: Sequence[bytes] = ()
    name: str = "bench"

    def __iter__(self) -> Iterator[Frame]:
        from frontend.sources.stills import decode_encoded

        period = max(2 * len(self.files) - 2, 1)
        for index in range(self.frame_count):
            place = min(index % period, period - index % period)
            right = decode_encoded(self.right[place]) if self.right else None
            yield Frame(index, index * PERIOD_NS, decode_encoded(self.files[place]), right=right)


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m frontend.bench",
        description="Frames per second and peak memory of the whole pipeline, with and without sinks.",
    )
    parser.add_argument("input", nargs="?", help="whatever frontend.run takes (default: the built-in clip)")
    shown = "sizes (default: " + " ".join(f"{width}x{height}" for width, height in SIZES) + ")"
    add = parser.add_argument
    add("--size", nargs="+", type=image_size, default=SIZES, metavar="WxH", help=shown)
    add("--preset", choices=PRESETS, default="default")
    add("--runtime", choices=RUNTIMES, default="auto")
    add("--stereo", action="store_true", help="pairs too, of an input that has them (default: the built-in clip's)")
    add("--frames", type=number(int, 2), default=150, metavar="N", help="per run (default: %(default)s)")
    parser.add_json()
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Measure, print the table and write the JSON.

    Raises:
        AirLineError: the input cannot be used.
    """
    from rich.console import Console

    from frontend.cli.settings import load

    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # as frontend.run does; the processes inherit it
    chosen = {"max_frames": CLIP_FRAMES, "stereo": options.stereo}
    config = load(None, {"preset": options.preset, "runtime": options.runtime, "input": chosen})
    clips = load_clips(options.input, options.size, config)
    sizes: dict[str, Figures] = {}
    with progress("runs", len(clips) * ROUNDS * (len(RUNS) - (not options.stereo)), unit="runs") as advance:
        for size, (files, right) in clips.items():
            sizes[size] = measure(ClipSource(files, options.frames, right), config, advance)
    Console().print(table(sizes))
    about = {"preset": options.preset, "runtime": options.runtime, "frames": options.frames, "cores": os.cpu_count()}
    write_json(options.json, {**about, "sizes": sizes})


def load_clips(
    spec: str | None, sizes: Sequence[tuple[int, int]], config: RunConfig
) -> dict[str, tuple[list[bytes], list[bytes]]]:
    """JPEG files of the first frames of an input, and of their right images, in every (width, height), px.

    The keys are "WIDTHxHEIGHT".

    Raises:
        AirLineError: the input cannot be used.
    """
    import cv2

    from airline.image import to_uint8
    from frontend.cli.wiring import open_input

    clips: dict[str, tuple[list[bytes], list[bytes]]] = {f"{width}x{height}": ([], []) for width, height in sizes}
    with closing(open_input(spec, config)) as source, progress(source.name, source.frame_count) as advance:
        for frame in source:
            images = [frame.image, *([] if frame.right is None else [frame.right])]
            for side, image in enumerate(images):
                for width, height in sizes:
                    method = cv2.INTER_AREA if width <= image.shape[1] else cv2.INTER_CUBIC
                    resized = cv2.resize(to_uint8(image), (width, height), interpolation=method)
                    file = cv2.imencode(".jpg", resized, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
                    clips[f"{width}x{height}"][side].append(file.tobytes())
            advance()
    if not all(files for files, _ in clips.values()):
        raise InputError(f"{source.name} yields no frame: give another input")
    return clips


def measure(clip: ClipSource, config: RunConfig, advance: Callable[[], None]) -> Figures:
    """All figures of one size: medians over rounds in which the runs take turns; of memory, the most."""
    runs = {name: run for name, run in RUNS.items() if clip.right or name != "fps_pairs"}
    found: dict[str, list[Figures]] = {name: [] for name in runs}
    lsd_ms: list[float] = []
    for _ in range(ROUNDS):
        for name, (sink, serial) in runs.items():
            frames = clip if name == "fps_pairs" else replace(clip, right=())
            spawn = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(1, mp_context=spawn) as pool:
                found[name].append(pool.submit(one_run, frames, config, sink, serial).result())
            lsd_ms += time_lsd(clip)
            advance()
    plain, serial_ms = found["fps"], [run["stage_ms"] for run in found["fps_serial"]]
    rates = {name: _median(run["fps"] for run in done) for name, done in found.items()}
    peaks = {name: max(run["peak_mb"] for run in done) for name, done in found.items()}
    of_pairs = {}
    if clip.right:
        of_pairs = {"pair_cost": rates["fps"] / rates["fps_pairs"], "peak_mb_pairs": peaks["fps_pairs"]}
    return {
        **rates,
        **of_pairs,
        "peak_mb": peaks["fps"],
        "peak_mb_rerun": peaks["fps_rerun"],
        "latency_ms": _median(run["latency_ms"] for run in plain),
        "lines": plain[0]["lines_per_frame"],
        "stage_ms": {stage: _median(spent[stage] for spent in serial_ms) for stage in plain[0]["stage_ms"]},
        "lsd_ms": _median(lsd_ms),
    }


def one_run(clip: ClipSource, config: RunConfig, kind: str, serial: bool) -> Figures:
    """The summary of one run of `frontend.run`, and its peak memory in MB over that before, with torch imported."""
    import msgspec
    import torch  # noqa: F401  what the memory is counted from

    from frontend.cli.wiring import open_recording, open_track_sink
    from frontend.run import process

    config = msgspec.structs.replace(config, serial=serial)
    with tempfile.TemporaryDirectory() as folder:

        def open_sinks() -> Iterator[Sink]:
            if kind == "rerun":
                yield open_recording(Path(folder) / "run.rrd", None, clip.name, config)
            elif kind == "mcap":
                yield open_track_sink(f"{folder}/run.mcap")

        before = memory_mb("VmRSS")
        _, summary = process(clip, config, open_sinks())
        return {**summary.to_dict(), "peak_mb": round(memory_mb("VmHWM") - before, 1)}


def time_lsd(clip: ClipSource) -> list[float]:
    """Milliseconds that OpenCV's LSD takes for frames all over the clip."""
    from airline.evaluation.benchmark import lsd
    from airline.image import to_uint8

    detect = lsd()
    spent = []
    for frame in ClipSource(clip.files[:: max(1, len(clip.files) // LSD_FRAMES)], LSD_FRAMES):
        gray = to_uint8(frame.gray)
        started = time.perf_counter()
        detect(gray)
        spent.append(1e3 * (time.perf_counter() - started))
    return spent


def table(sizes: dict[str, Figures]) -> Table:
    """One column per size."""
    from rich.table import Table

    shown = Table("", *sizes)
    for key, title in ROWS.items():
        if all(key in figures for figures in sizes.values()):
            digits = 2 if key == "pair_cost" else 1
            shown.add_row(title, *(f"{figures[key]:.{digits}f}" for figures in sizes.values()))
    stages = [stage for figures in sizes.values() for stage in figures["stage_ms"]]
    for stage in dict.fromkeys(stages):
        shown.add_row(f"{stage}, ms in series", *(f"{figures['stage_ms'][stage]:.2f}" for figures in sizes.values()))
    return shown


def memory_mb(field: str) -> float:
    """Of this process: VmRSS is what it has now, VmHWM the most it had. NaN where the system does not say."""
    status = Path("/proc/self/status")  # getrusage would count the parent's memory before exec
    if not status.exists():
        return float("nan")
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    return int(lines[field].split()[0]) / 1024


def _median(values: Iterator[float] | list[float]) -> float:
    return round(statistics.median(values), 3)


if __name__ == "__main__":
    sys.exit(main())

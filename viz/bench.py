"""What logging a run costs, in time and bytes: `python -m viz.bench --frames 100 --json bench.json`.

The frames are those of the built-in clip, 640x480, detected and tracked before the clock starts, and come 30 times a
second. Pictures are encoded in a thread beside the next frame: the time in `write` is what a run waits, the processor
time what all threads spend.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from airline.command import EXIT_USER_ERROR, Parser
from airline.errors import AirLineError, InputError
from frontend.protocols import FrameResult
from viz.rerun_sink import ImageMode, RerunSink

PERIOD_S = 1 / 30
MODES: tuple[ImageMode, ...] = ("jpeg", "raw", "video", "none")


@dataclass(frozen=True)
class Cost:
    """Of one frame, on average.

    Attributes:
        write_ms: median time a run waits in `write`.
        processor_ms: mean time that all threads spend to make, encode, compress and write everything.
        kilobytes: of the whole file, by 1000 bytes.
        entities: kilobytes of each entity before the file's compression.
    """

    write_ms: float
    processor_ms: float
    kilobytes: float
    entities: dict[str, float]


def results_of_clip(frames: int) -> list[FrameResult]:
    """The first frames of the built-in clip, detected and tracked."""
    from frontend.pipeline import LineFrontend
    from frontend.sources.scene import SceneSource

    frontend = LineFrontend()
    return [frontend.process(frame) for frame in islice(SceneSource(), frames)]


def measure(results: Sequence[FrameResult], path: Path, mode: ImageMode, video: Path, **options: Any) -> Cost:
    """Record results into a file and weigh it."""
    sink = RerunSink(save=path, image=mode, video=video if mode == "video" else None, **options)
    waited = []
    begin = time.process_time()
    for result in results:
        started = time.perf_counter()
        sink.write(result)
        waited.append(time.perf_counter() - started)
        time.sleep(max(0.0, PERIOD_S - waited[-1]))
    sink.close()
    spent = time.process_time() - begin
    count = len(results)
    size = path.stat().st_size
    return Cost(1e3 * float(np.median(waited)), 1e3 * spent / count, size / count / 1e3, entity_sizes(path, count))


def entity_sizes(path: Path, frames: int) -> dict[str, float]:
    """Kilobytes per frame of each entity, before compression."""
    from rerun.chunk import RrdReader

    sizes: dict[str, float] = defaultdict(float)
    for chunk in RrdReader(path).stream().to_chunks():
        sizes[str(chunk.entity_path)] += chunk.to_record_batch().nbytes / frames / 1e3
    return dict(sorted(sizes.items()))


def write_video(results: Sequence[FrameResult], path: Path) -> None:
    """The frames' images as an H.264 file, as a camera or a phone would write it."""
    import av

    height, width = results[0].frame.image.shape[:2]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for result in results:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(result.frame.image, format="bgr24")))
        container.mux(stream.encode(None))


def table(costs: Mapping[ImageMode, Cost]) -> str:
    """Lines of text, a mode in each, and the entities of the default."""
    rows = ["--log-image   ms in write   ms of processor   KB per frame"]
    rows += [
        f"{mode:12}{cost.write_ms:13.2f}{cost.processor_ms:18.2f}{cost.kilobytes:15.1f}" for mode, cost in costs.items()
    ]
    rows += ["", "entity, uncompressed           KB per frame"]
    rows += [f"{entity:29}{size:14.2f}" for entity, size in costs["jpeg"].entities.items()]
    return "\n".join(rows)


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = Parser(prog="python -m viz.bench", description="What logging a run costs.")
    parser.add_argument("--frames", type=_positive, default=100, help="of the built-in clip (default: 100)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args(arguments)
    try:
        if options.json is not None and not options.json.parent.is_dir():
            raise InputError(f"cannot write {options.json}: create its folder first")
        results = results_of_clip(options.frames)
        with tempfile.TemporaryDirectory() as folder:
            video = Path(folder) / "clip.mp4"
            write_video(results, video)
            costs = {mode: measure(results, Path(folder) / f"{mode}.rrd", mode, video) for mode in MODES}
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    print(table(costs))
    if options.json is not None:
        figures = {mode: asdict(cost) for mode, cost in costs.items()}
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError("must be 1 or more")
    return number


if __name__ == "__main__":
    sys.exit(main())

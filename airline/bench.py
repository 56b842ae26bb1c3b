"""How fast the detector is, beside OpenCV's LSD in the same run: `python -m airline.bench`.

`--cost FILE.png` draws the time over the size of the image and, at one size, over the number of lines.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from itertools import chain, islice, product, repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from airline.command import Parser, exit_code, image_size, number, write_json
from airline.config import PRESETS, RUNTIMES
from airline.errors import ConfigError, InputError

if TYPE_CHECKING:
    from airline.detector import AirLine

PICTURES = 10  # of the built-in clip, far apart
SPACING = 12  # frames between them
WARM_UP = 3
# of the picture of the cost: sizes, relative to the one that is asked for; kinds and seeds of scenes with few and with
# many lines
FACTORS = (0.5, 1, 1.5, 2, 3)
SCENES = [*product(("indoor", "street", "shelves"), range(12, 18))]


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(prog="python -m airline.bench", description="Time the detector beside OpenCV's LSD, interleaved.")
    add = parser.add_argument
    add("images", nargs="*", type=Path, help="image files (default: pictures of the built-in clip)")
    add("--size", type=image_size, default="640x480", metavar="WxH", help="resize to this (default: %(default)s)")
    add("--preset", choices=PRESETS, default="default")
    add("--runtime", choices=RUNTIMES, default="auto")
    add("--threads", type=number(int, 1), metavar="N", help="use so many processor cores (default: all)")
    add("--rounds", type=number(int, 1), default=5, metavar="N", help="over all images (default: %(default)s)")
    add("--cost", type=Path, metavar="FILE.png", help="draw time over image size and number of lines")
    parser.add_json()
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Measure, print the table and write the JSON; raises AirLineError."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    if options.cost is not None and (options.cost.suffix != ".png" or not options.cost.parent.is_dir()):
        raise InputError(f"cannot write {options.cost}: give a name that ends with .png in a folder that exists")
    _limit_cores(options.threads)
    from airline.detector import AirLine  # libraries count the cores when they load

    pictures = load_pictures(options.images, options.size)
    detector = AirLine(options.preset, runtime=options.runtime)
    figures = measure(detector, pictures, options.rounds)
    size = "{}x{}".format(*options.size)
    runtime = getattr(detector.edges, "network", detector.edges)
    name = getattr(runtime, "name", type(runtime).__name__)
    figures = {"preset": options.preset, "runtime": name, "size": size, **figures}
    print(as_text(figures))
    if options.cost is not None:
        print(draw_cost(options.cost, detector, options.images, options.size, options.rounds))
    write_json(options.json, figures)


def load_pictures(paths: Sequence[Path], size: tuple[int, int]) -> list[NDArray[np.uint8]]:
    """Grey pictures of one (width, height); InputError where an image cannot be read."""
    import cv2

    if paths:
        loaded = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]
        for path, image in zip(paths, loaded, strict=True):
            if image is None:
                raise InputError(f"cannot read the image {path}")
    else:
        from airline.scenes import RenderedClip

        clip = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=PICTURES * SPACING)
        loaded = [cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY) for view in islice(clip, 0, None, SPACING)]
    return [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in loaded]


def measure(detector: AirLine, pictures: Sequence[NDArray[np.uint8]], rounds: int) -> dict[str, Any]:
    """Milliseconds of every stage, in total, and of LSD, one after the other on each picture; then many at once."""
    import cv2

    lsd = cv2.createLineSegmentDetector()
    spent: dict[str, list[float]] = {}
    lines: list[int] = []
    for _ in range(WARM_UP):
        detector(pictures[0])
        lsd.detect(pictures[0])
    for picture in [picture for _ in range(rounds) for picture in pictures]:
        started = time.perf_counter()
        trace = detector.trace(picture)
        traced = time.perf_counter()
        lsd.detect(picture)
        total, peer = 1e3 * (traced - started), 1e3 * (time.perf_counter() - traced)
        lines.append(len(trace.lines))
        for name, ms in {**trace.stage_ms, "total": total, "LSD": peer}.items():
            spent.setdefault(name, []).append(ms)
    started = time.perf_counter()
    batch = sum(1 for _ in detector.detect_batch(chain.from_iterable(repeat(pictures, rounds))))
    batch_s = time.perf_counter() - started
    medians = {name: round(float(np.median(ms)), 3) for name, ms in spent.items()}
    p95 = {name: round(float(np.percentile(ms, 95)), 3) for name, ms in spent.items()}
    return {
        "pictures": len(lines),
        "lines": float(np.mean(lines)),
        "total_ms": medians.pop("total"),
        "total_p95_ms": p95.pop("total"),
        "lsd_ms": medians.pop("LSD"),
        "lsd_p95_ms": p95.pop("LSD"),
        "stage_ms": medians,
        "stage_p95_ms": p95,
        "ratio_lsd": round(float(np.median(spent["LSD"]) / np.median(spent["total"])), 3),
        "batch_fps": round(batch / batch_s, 1),
    }


def as_text(figures: dict[str, Any]) -> str:
    """The figures as aligned columns."""
    head = f"{figures['preset']}, {figures['runtime']}, {figures['size']}, {figures['lines']:.0f} lines"
    rows = [(stage, ms, figures["stage_p95_ms"][stage]) for stage, ms in figures["stage_ms"].items()]
    rows += [("total", figures["total_ms"], figures["total_p95_ms"]), ("LSD", figures["lsd_ms"], figures["lsd_p95_ms"])]
    table = [f"{head}\n{'':12}{'median ms':>10}{'p95 ms':>10}"]
    table += [f"{name:12}{median:10.2f}{p95:10.2f}" for name, median, p95 in rows]
    table.append(f"LSD takes {figures['ratio_lsd']:.2f} times as long as the detector")
    return "\n".join([*table, f"many images at once (detect_batch): {figures['batch_fps']:.0f} images/s"])


def draw_cost(path: Path, detector: AirLine, images: Sequence[Path], size: tuple[int, int], rounds: int) -> str:
    """Measure over sizes around `size` and over pictures of that size, draw both, and give a table of the sizes."""
    from airline.evaluation.plots import COLOURS, new_axes, save

    curves = {
        "lsd_ms": (COLOURS[1], "s", "OpenCV LSD"),
        "total_ms": (COLOURS[0], "o", "AirLine"),
        "rest_ms": (COLOURS[2], "^", "of that, the stages after the network"),
    }
    figure, (left, right) = new_axes(("image size, megapixels", "time, LSD = 1"), ("lines in a picture", ""))
    sizes = [(round(factor * size[0]), round(factor * size[1])) for factor in FACTORS]
    over_sizes = [_cost_of(detector, load_pictures(images, each), rounds) for each in sizes]
    singles = load_pictures(images, size) if images else _scenes(size)
    over_lines = [_cost_of(detector, [picture], 3 * rounds) for picture in singles]
    unit = float(np.median([point["lsd_ms"] for point in over_lines]))
    for axes, points, place in ((left, over_sizes, "megapixels"), (right, over_lines, "lines")):
        for key, (colour, marker, name) in curves.items():
            x, y = [point[place] for point in points], [point[key] / unit for point in points]
            line = "-" if axes is left else "none"  # pictures with as many lines are not alike
            axes.plot(x, y, linestyle=line, color=colour, marker=marker, label=name)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    left.legend(fontsize=8)
    save(figure, path)
    rows = ["size       lines  network ms  other stages ms   LSD ms  LSD / ours"]
    for (width, height), point in zip(sizes, over_sizes, strict=True):
        total, rest, lsd = (point[key] for key in ("total_ms", "rest_ms", "lsd_ms"))
        row = f"{f'{width}x{height}':10}{point['lines']:6.0f}{total - rest:12.2f}{rest:17.2f}{lsd:9.2f}"
        rows.append(f"{row}{lsd / total:12.2f}")
    return "\n".join([*rows, f"wrote {path}"])


def _scenes(size: tuple[int, int]) -> list[NDArray[Any]]:
    """Grey pictures with few and with many lines."""
    import cv2

    from airline.scenes import RenderedClip

    views = (RenderedClip(kind, "handheld", seed, frames=8, size=size).render(0) for kind, seed in SCENES)
    return [cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY) for view in views]


def _cost_of(detector: AirLine, pictures: Sequence[NDArray[Any]], rounds: int) -> dict[str, Any]:
    """Figures of `measure`, with megapixels and the median of the stages after the network, ms."""
    figures = measure(detector, pictures, rounds)
    rest = figures["total_ms"] - figures["stage_ms"]["edges"]
    return {**figures, "megapixels": pictures[0].size / 1e6, "rest_ms": rest}


def _limit_cores(threads: int | None) -> None:
    if threads is None:
        return
    if not hasattr(os, "sched_setaffinity"):
        raise ConfigError("--threads needs Linux, where a process can be kept to some cores")
    cores = sorted(os.sched_getaffinity(0))
    if threads > len(cores):
        raise ConfigError(f"--threads must be between 1 and {len(cores)}, not {threads}")
    os.sched_setaffinity(0, cores[:threads])
    os.environ["OMP_NUM_THREADS"] = str(threads)


if __name__ == "__main__":
    sys.exit(main())

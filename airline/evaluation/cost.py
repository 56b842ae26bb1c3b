"""What the detector's time depends on, and its floor: `python -m airline.evaluation.cost --out docs/cost.png`.

The picture shows time over image size and, at one size, over the number of lines, beside OpenCV's LSD. Printed is the
floor of the edge network: its multiplications at the rate that a large convolution reaches here, and the bytes that its
layers read and write at the rate that a large copy reaches.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from airline.bench import load_pictures, measure, runtime_name
from airline.command import Parser, exit_code
from airline.errors import ConfigError, InputError, from_extra
from airline.evaluation.plots import COLOURS, DPI, new_axes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from airline.detector import AirLine
    from airline.network.spec import UNetSpec

SIZES = ["320x240", "640x480", "1280x720", "1920x1080"]
LINES_AT = "640x480"
KINDS = ("indoor", "street", "shelves")
SEEDS = range(12, 18)
BYTES = {"int8": 1, "bf16": 2, "f32": 4}  # of an activation
CONVOLUTION = 256, 64  # channels and side of the one that measures the peak

CURVES = (
    (COLOURS[1], "s", "OpenCV LSD", "lsd_ms"),
    (COLOURS[0], "o", "AirLine", "total_ms"),
    (COLOURS[2], "^", "of that, the stages after the network", "back_end_ms"),
)


@dataclass(frozen=True)
class Point:
    """One measurement.

    Attributes:
        size: "WIDTHxHEIGHT".
        lines: how many were found, on average.
        network_ms, back_end_ms, lsd_ms: medians.
    """

    size: str
    lines: float
    network_ms: float
    back_end_ms: float
    lsd_ms: float

    @property
    def total_ms(self) -> float:
        """Of the whole detector."""
        return self.network_ms + self.back_end_ms

    @property
    def megapixels(self) -> float:
        """Of the image."""
        width, _, height = self.size.partition("x")
        return int(width) * int(height) / 1e6


def over_sizes(detector: AirLine, sizes: Sequence[str], paths: Sequence[Path], rounds: int) -> list[Point]:
    """All pictures at each size."""
    return [_point(detector, load_pictures(paths, size), size, rounds) for size in sizes]


def over_lines(detector: AirLine, paths: Sequence[Path], rounds: int) -> list[Point]:
    """Each picture by itself, at one size."""
    pictures = load_pictures(paths, LINES_AT) if paths else _scenes()
    return [_point(detector, [picture], LINES_AT, 3 * rounds) for picture in pictures]


def _scenes() -> list[Any]:
    """Grey pictures of rendered scenes with few and with many lines."""
    import cv2

    from airline.scenes import RenderedClip as Clip

    clips = [Clip(kind=kind, motion="handheld", seed=seed, frames=8) for kind in KINDS for seed in SEEDS]
    return [cv2.cvtColor(clip.render(0).image, cv2.COLOR_BGR2GRAY) for clip in clips]


def _point(detector: AirLine, pictures: Sequence[Any], size: str, rounds: int) -> Point:
    figures = measure(detector, pictures, rounds)
    network = figures["stage_ms"]["edges"]
    return Point(size, figures["lines"], network, figures["total_ms"] - network, figures["lsd_ms"])


def draw(sizes: Sequence[Point], pictures: Sequence[Point]) -> Figure:
    """Time over megapixels, and time over the number of lines."""
    figure, (left, right) = new_axes(
        ("image size, megapixels", "time, LSD at 640x480 = 1"), (f"lines in a picture of {LINES_AT}", "")
    )
    unit = float(np.median([point.lsd_ms for point in pictures]))
    for axes, points, place in ((left, sizes, "megapixels"), (right, pictures, "lines")):
        ordered = sorted(points, key=attrgetter(place))
        x = [getattr(point, place) for point in ordered]
        for colour, marker, name, value in CURVES:
            y = [getattr(point, value) / unit for point in ordered]
            line = "-" if axes is left else "none"  # pictures with as many lines are not alike
            axes.plot(x, y, linestyle=line, color=colour, marker=marker, label=name)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    left.legend(fontsize=8)
    return figure


def layer_costs(spec: UNetSpec, height: int, width: int) -> tuple[float, float]:
    """Multiplications of the network for one image, and numbers that its convolutions read and write."""
    rows, columns = spec.folded_size(height, width)
    products = moved = 0
    for name, shape in spec.shapes().items():
        if not name.endswith(".weight"):
            continue
        outputs, inputs, side, _ = shape
        part, _, level = name.removesuffix(".weight").partition(".")
        halvings = int(level.split(".")[0]) + (part == "lateral") if level else 0
        pixels = (rows >> halvings) * (columns >> halvings)
        products += pixels * outputs * inputs * side * side
        moved += pixels * (outputs + inputs)
    return float(products), float(moved)


def peak_products_per_ms(precision: str) -> float:
    """Multiplications per millisecond of a large convolution in OpenVINO, in one of `BYTES`."""
    with from_extra("openvino"):
        import openvino as ov
        from openvino import opset13 as op

        from airline.network.openvino_cpu import CORE

    channels, side = CONVOLUTION
    image = op.parameter([1, channels, side, side], np.float32)
    kernel = np.random.default_rng(0).standard_normal((channels, channels, 3, 3)).astype(np.float32)
    layers: Any = image
    ends = np.float32(-1), np.float32(1)
    narrowed = precision == "int8"
    for _ in range(4):  # in a row, so that what is converted at both ends does not count much
        weights: Any = kernel
        if narrowed:
            layers, weights = (op.fake_quantize(each, *ends, *ends, 255) for each in (layers, op.constant(kernel)))
        layers = op.convolution(layers, weights, [1, 1], [1, 1], [1, 1], [1, 1])
    hint = "f32" if narrowed else precision
    options = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_PRECISION_HINT": hint}
    request = CORE.compile_model(ov.Model([layers], [image], "peak"), "CPU", options).create_infer_request()
    return 4 * side * side * channels * channels * 9 / _least_ms(request.infer)


def copied_bytes_per_ms() -> float:
    """Bytes read plus bytes written per millisecond by a copy that no cache of a core holds."""
    source = np.ones(16 << 20, np.uint8)
    target = np.empty_like(source)
    return 2 * source.nbytes / _least_ms(lambda: np.copyto(target, source))


def _least_ms(call: Callable[[], Any], times: int = 30) -> float:
    spent = []
    for _ in range(times):
        started = time.perf_counter()
        call()
        spent.append(1e3 * (time.perf_counter() - started))
    return min(spent)


def floor_text(spec: UNetSpec, precision: str, network_ms: float) -> str:
    """The floor of the network at 640x480, as lines of text."""
    products, numbers = layer_costs(spec, 480, 640)
    moved = numbers * BYTES[precision]
    peak, bandwidth = peak_products_per_ms(precision), copied_bytes_per_ms()
    return "\n".join(
        [
            f"network at 640x480: {network_ms:.2f} ms with its input and output",
            f"  {products / 1e9:.2f} GMAC at {peak / 1e6:.0f} GMAC/s: {products / peak:.2f} ms",
            f"  {moved / 1e6:.1f} MB at {bandwidth / 1e6:.1f} GB/s: {moved / bandwidth:.2f} ms",
        ]
    )


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m airline.evaluation.cost", description="Time over image size and number of lines; the floor."
    )
    parser.add_argument("images", nargs="*", type=Path, help="image files (default: pictures of the built-in clip)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png", help="picture to write")
    parser.add_argument("--preset", choices=["default", "fast", "accurate"], default="default")
    parser.add_argument("--size", nargs="+", default=SIZES, metavar="WxH", help="sizes (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="over all images (default: %(default)s)")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Measure, draw, print; raises AirLineError."""
    from airline.config import preset
    from airline.detector import AirLine
    from airline.network.processor import vector_instructions
    from airline.network.weights import load_weights

    if options.rounds < 1:
        raise ConfigError("--rounds must be 1 or more")
    if options.out.suffix != ".png" or not options.out.parent.is_dir():
        raise InputError(f"cannot write {options.out}: give a name that ends with .png in a folder that exists")
    detector = AirLine(options.preset, runtime="openvino" if vector_instructions() is None else "native")
    sizes = over_sizes(detector, options.size, options.images, options.rounds)
    figure = draw(sizes, over_lines(detector, options.images, options.rounds))
    try:
        figure.savefig(options.out, dpi=DPI, metadata={"Software": None})
    except OSError as error:
        raise InputError(f"cannot write {options.out} ({error.strerror}): give another --out") from None
    print("size       lines  network ms  other stages ms   LSD ms  LSD / ours")
    for point in sizes:
        row = f"{point.size:10}{point.lines:6.0f}{point.network_ms:12.2f}{point.back_end_ms:17.2f}"
        print(f"{row}{point.lsd_ms:9.2f}{point.lsd_ms / point.total_ms:12.2f}")
    spec, _ = load_weights(preset(options.preset).edges.weights)
    network = next((point.network_ms for point in sizes if point.size == "640x480"), None)
    if network is not None:
        print(floor_text(spec, runtime_name(detector).split()[-1], network))
    print(f"wrote {options.out}")


if __name__ == "__main__":
    sys.exit(main())

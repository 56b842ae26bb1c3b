"""Two runs side by side in one recording: `python -m viz.compare A B [INPUT] [--save compare.rrd]`.

A and B are each a file with tracks (.mcap, .parquet), or what to run on the input with: a preset, a settings file
(.toml) or a weights file (.safetensors). Frames are matched by their stamps, lines by where they lie.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

from airline.command import EXIT_USER_ERROR, Parser
from airline.config import PRESETS
from airline.errors import AirLineError, InputError
from viz.moments import Moment, joined

if TYPE_CHECKING:
    import argparse

    import rerun as rr

    from frontend.cli.settings import RunConfig
    from frontend.pipeline import LineFrontend
    from frontend.protocols import Source
    from viz.comparison import Comparison

JPEG_QUALITY = 80
EXIT_INTERRUPTED = 130

log = logging.getLogger(__name__)


def is_track_file(spec: str) -> bool:
    """Whether a run is given by its results."""
    return spec not in PRESETS and Path(spec).suffix.lower() in (".mcap", ".parquet", ".unfinished")


def config_of(spec: str) -> RunConfig:
    """The settings that a preset, a settings file or a weights file stands for; raises InputError for anything else."""
    from frontend.cli.settings import load

    if spec in PRESETS:
        return load(None, {"preset": spec})
    if spec.lower().endswith(".toml"):
        return load(Path(spec), {})
    if spec.lower().endswith(".safetensors"):
        return load(None, {"detector": {"edges": {"weights": spec}}})
    raise InputError(
        f"cannot compare '{spec}': give a file with tracks (.mcap, .parquet), a preset ({', '.join(PRESETS)}), "
        "a settings file (.toml) or weights (.safetensors)"
    )


def compare(a: str, b: str, source: Source | None, open_stream: Callable[[], rr.RecordingStream]) -> Comparison:
    """Record two runs.

    Args:
        a, b: see the module.
        source: the input; None for two files, whose own images are used where they have some.
        open_stream: where to record to; called when both runs have shown that they have a frame in common.

    Returns:
        The figures.

    Raises:
        InputError: a file or the input cannot be read, or the two have no frame in common.
    """
    from viz.comparison import Comparison, layout
    from viz.track_recording import size_of

    names = f"A: {name_of(a)}", f"B: {name_of(b)}"
    comparison: Comparison | None = None
    for moments in joined(open_streams(a, b, source), (a, b)):
        first, second = (tracks for moment in moments for tracks in moment.tracks)
        if is_track_file(a) and not is_track_file(b):  # runs come first
            first, second = second, first
        if comparison is None:
            stream = open_stream()
            stream.send_blueprint(layout(names, size_of(first)))
            comparison = Comparison(stream, names)
        comparison.write(first, second, next((m.image for m in moments if m.image is not None), None))
    assert comparison is not None  # or else `joined` has raised
    return comparison


def open_streams(a: str, b: str, source: Source | None) -> list[Iterator[Moment]]:
    """The input with the runs on it, then the files."""
    from frontend.pipeline import open_frontend

    runs = [open_frontend(config_of(spec)) for spec in (a, b) if not is_track_file(spec)]
    files = [Path(spec) for spec in (a, b) if is_track_file(spec)]
    streams = [] if source is None else [run_moments(source, runs)]
    return streams + [file_moments(path, with_images=source is None) for path in files]


def run_moments(source: Source, frontends: Sequence[LineFrontend]) -> Iterator[Moment]:
    """The images of a source, and what each of the runs finds in them."""
    import cv2

    from airline.image import to_uint8
    from frontend.cli.terminal import progress

    with progress(source.name, source.frame_count) as advance:
        for frame in source:
            tracks = tuple(frontend.process(frame).tracks for frontend in frontends)
            _, jpeg = cv2.imencode(".jpg", to_uint8(frame.image), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            yield Moment(frame.stamp_ns, tracks, jpeg.tobytes())
            advance()


def file_moments(path: Path, *, with_images: bool) -> Iterator[Moment]:
    """The frames of a file with tracks, and its images where it has some."""
    from logs import read_tracks
    from viz.track_files import images_of
    from viz.track_recording import paired

    for tracks, image in paired(read_tracks(path), images_of(path) if with_images else iter(())):
        yield Moment(tracks.stamp_ns, (tracks,), image)


def name_of(spec: str) -> str:
    """A preset's name, or a file's."""
    return spec if spec in PRESETS else Path(spec).name


def open_input(options: argparse.Namespace) -> Source | None:
    """The frames to run on, and to show; the built-in clip where a run needs frames and none are given."""
    if options.input is None and is_track_file(options.a) and is_track_file(options.b):
        return None
    from frontend.cli.settings import load
    from frontend.cli.wiring import open_input as open_frames

    chosen = {"start": options.start, "end": options.end, "max_frames": options.max_frames}
    return open_frames(
        options.input, load(None, {"input": {name: value for name, value in chosen.items() if value is not None}})
    )


def open_stream(save: Path | None, name: str, closed: ExitStack) -> rr.RecordingStream:
    """A recording into a file, or into a viewer's window; finished when `closed` ends."""
    import rerun as rr

    from viz.destination import Destination, batches

    address = None
    if save is None:
        from viz.viewer import open_viewer

        address = open_viewer()
        if address is None:
            raise InputError("no viewer window could be opened: give a file with --save compare.rrd")
    stream = rr.RecordingStream("airline-compare", batcher_config=batches(live=save is None))
    stream.set_log_time_enabled(False)
    closed.callback(Destination(stream, save, address).close)
    stream.send_recording_name(name)
    return stream


def run(options: argparse.Namespace) -> None:
    """Compare, record and print the figures."""
    if options.save is not None and (options.save.suffix.lower() != ".rrd" or not options.save.parent.is_dir()):
        raise InputError(f"cannot write --save {options.save}: give a name that ends with .rrd in a folder that exists")
    for spec in (options.a, options.b):
        if is_track_file(spec) and not Path(spec).is_file():
            raise InputError(f"cannot read tracks from '{spec}': there is no such file")
        if not is_track_file(spec):
            config_of(spec)
    with ExitStack() as closed:
        source = open_input(options)
        if source is not None:
            closed.enter_context(closing(source))
        name = f"{name_of(options.a)} and {name_of(options.b)}"
        comparison = compare(options.a, options.b, source, lambda: open_stream(options.save, name, closed))
    from rich.console import Console

    Console().print(comparison.table())


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = Parser(prog="python -m viz.compare", description="Shows two runs side by side in a Rerun recording.")
    kinds = "file with tracks, preset, .toml or .safetensors"
    parser.add_argument("a", metavar="A", help=kinds)
    parser.add_argument("b", metavar="B", help=kinds)
    parser.add_argument("input", nargs="?", metavar="INPUT", help="what to run on: video, folder, log (built-in clip)")
    parser.add_argument("--save", type=Path, metavar="FILE.rrd", help="record into this file instead of a viewer")
    parser.add_argument("--start", type=float, metavar="S", help="skip the first S seconds of INPUT")
    parser.add_argument("--end", type=float, metavar="S", help="stop S seconds after its first frame")
    parser.add_argument("--max-frames", type=int, metavar="N", help="stop after N frames")
    options = parser.parse_args(arguments)
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # as in frontend.run
    try:
        run(options)
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    return 0


if __name__ == "__main__":
    sys.exit(main())

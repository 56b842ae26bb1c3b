"""The command line: `python -m frontend.run [INPUT]`. The one place that wires source, detector, tracker and sinks."""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from airline import __version__
from airline.errors import AirLineError, ConfigError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from frontend.protocols import Sink, Source
    from frontend.settings import RunConfig
    from frontend.summary import Summary

log = logging.getLogger("frontend.run")

EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130


class Parser(argparse.ArgumentParser):
    """Prints errors as one sentence."""

    def error(self, message: str) -> NoReturn:
        """Print and exit with 2."""
        self.exit(EXIT_USER_ERROR, f"error: {message}; see --help\n")


def build_parser() -> argparse.ArgumentParser:
    """All flags; those without a default leave the setting as the preset or the --config file has it."""
    parser = Parser(
        prog="python -m frontend.run",
        description="Detect and track line segments in a stream and record everything for the Rerun viewer.",
    )
    parser.add_argument(
        "input",
        nargs="?",
        help="video file, image folder or glob, camera index, stream URL or .mcap log (default: the built-in clip)",
    )
    parser.add_argument("--version", action="version", version=f"airline-frontend {__version__}")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="say more; twice for debugging")
    output = parser.add_argument_group("output")
    output.add_argument("--save", type=Path, metavar="FILE.rrd", help="record into this file instead of a viewer")
    output.add_argument("--headless", action="store_true", help="open no viewer even where there is a display")
    output.add_argument("--summary", type=Path, metavar="FILE.json", help="write the final figures as JSON")
    frames = parser.add_argument_group("frames")
    frames.add_argument("--start", type=float, metavar="S", help="skip the first S seconds")
    frames.add_argument("--end", type=float, metavar="S", help="stop S seconds after the first frame")
    frames.add_argument("--stride", type=int, metavar="N", help="use every N-th frame")
    frames.add_argument("--max-frames", type=int, metavar="N", help="stop after N frames")
    frames.add_argument("--resize", metavar="WxH", help="resize frames, e.g. 640x480, or 640 to keep the aspect")
    frames.add_argument("--fps", type=float, help="frame rate of image folders without timestamps")
    frames.add_argument("--topic", help="image topic of a log")
    model = parser.add_argument_group("detector")
    model.add_argument("--preset", choices=["default", "paper"], help="settings to start from")
    model.add_argument("--weights", metavar="FILE", help="weights of the edge network (.safetensors)")
    model.add_argument("--device", choices=["auto", "cpu", "cuda"], help="where the edge network runs")
    settings = parser.add_argument_group("settings")
    settings.add_argument("--config", type=Path, metavar="FILE.toml", help="settings; flags override them")
    settings.add_argument("--dump-config", action="store_true", help="print all settings as TOML and exit")
    return parser


def settings_of(options: argparse.Namespace) -> dict[str, Any]:
    """The flags that were given, in the settings' own structure."""
    names = ("start", "end", "stride", "max_frames", "resize", "fps", "topic")
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    flags: dict[str, Any] = {"input": given} if given else {}
    for name in ("preset", "device"):
        if getattr(options, name) is not None:
            flags[name] = getattr(options, name)
    if options.weights is not None:
        flags["detector"] = {"edges": {"weights": options.weights}}
    return flags


def open_input(spec: str | None, config: RunConfig) -> Source:
    """The frames that the input and the frame settings stand for."""
    from frontend.select import select_frames
    from frontend.sources import open_source

    source: Source
    if spec is None:
        from frontend.sources.scene import SceneSource

        source = SceneSource()
    elif Path(spec).suffix.lower() == ".mcap":
        from logs import McapSource

        source = McapSource(spec, topic=config.input.topic)
    else:
        source = open_source(spec, fps=config.input.fps)
    chosen = config.input
    return select_frames(
        source,
        start_s=chosen.start,
        end_s=chosen.end,
        stride=chosen.stride,
        max_frames=chosen.max_frames,
        resize=parse_size(chosen.resize),
    )


def parse_size(text: str | None) -> tuple[int, int | None] | None:
    """(width, height or None) of "640x480" or "640".

    Raises:
        ConfigError: it is neither.
    """
    if text is None:
        return None
    width, separator, height = text.lower().partition("x")
    try:
        return int(width), int(height) if separator else None
    except ValueError:
        raise ConfigError(f"cannot resize to '{text}': give WIDTHxHEIGHT or WIDTH in pixels, e.g. 640x480") from None


def has_display() -> bool:
    """Whether a viewer window could open here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_output(path: Path | None, flag: str) -> None:
    """Refuse an output path whose folder is missing, before any work."""
    if path is not None and (not path.parent.is_dir() or path.is_dir()):
        raise InputError(f"cannot write {flag} {path}: give a file name in an existing folder")


def run(options: argparse.Namespace, config: RunConfig) -> int:
    """Run the pipeline until the input ends or Ctrl-C; print and write the summary; returns the exit code."""
    check_output(options.save, "--save")
    check_output(options.summary, "--summary")
    source = open_input(options.input, config)
    save: Path | None = options.save
    if save is None and (options.headless or not has_display()):
        save = Path(f"{source.name}.rrd")

    def open_sinks() -> list[Sink]:
        from viz.rerun_sink import RerunSink

        recording = config.recording
        return [
            RerunSink(
                save=save,
                spawn=save is None,
                descriptor_every=recording.descriptor_every,
                jpeg_quality=recording.jpeg_quality,
            )
        ]

    code, summary = process(source, config, open_sinks)
    from rich.console import Console

    Console().print(summary.table())
    if options.summary is not None:
        options.summary.write_text(json.dumps(summary.to_dict(), indent=2) + "\n", encoding="utf-8")
    if save is not None and summary.frames:
        print(f"saved {save}; look at it with: rerun {save}")
    return code


def process(source: Source, config: RunConfig, open_sinks: Callable[[], list[Sink]]) -> tuple[int, Summary]:
    """Push every frame through detector, tracker and sinks.

    Sinks are opened when the first frame has been read, so that a bad input leaves earlier output files alone, and
    are closed whatever happens.
    """
    from airline.detector import AirLine
    from frontend.pipeline import LineFrontend
    from frontend.summary import SummaryCounter
    from frontend.tracker import LineTracker

    device: Any = config.device
    frontend = LineFrontend(AirLine(config=config.detector, device=device), LineTracker(config.tracker))
    counter = SummaryCounter(config.tracker.confirm_hits)
    sinks: list[Sink] = []
    code = 0
    try:
        with progress(source) as advance:
            for frame in source:
                sinks = sinks or open_sinks()
                result = frontend.process(frame)
                started = time.perf_counter()
                for sink in sinks:
                    sink.write(result)
                counter.add(result)
                counter.add_time({"sinks": 1e3 * (time.perf_counter() - started)})
                advance()
    except KeyboardInterrupt:
        code = EXIT_INTERRUPTED
        log.warning("interrupted: what was done so far is kept")
    except AirLineError as error:
        if not sinks:
            raise
        code = EXIT_USER_ERROR
        print(f"error: {error}", file=sys.stderr)
    finally:
        for sink in sinks:
            sink.close()
        source.close()
    summary = counter.summary(source.skipped)
    if not summary.frames and code == 0:
        raise InputError(f"{source.name} yields no frame: check the input and --start, --end, --stride")
    return code, summary


@contextmanager
def progress(source: Source) -> Iterator[Callable[[], None]]:
    """A progress bar with frames/s on stderr; none where that is no terminal. Yields what to call per frame."""
    if not sys.stderr.isatty():
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text(f"{speed:.1f} frames/s" if speed else "")

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(source.name, total=source.frame_count)
        yield lambda: bar.advance(task)


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code: 0, 2 for errors a user can mend, 130 after Ctrl-C."""
    options = build_parser().parse_args(arguments)
    level = [logging.WARNING, logging.INFO, logging.DEBUG][min(options.verbose, 2)]
    logging.basicConfig(level=level, format="%(levelname)s: %(message)s" if level == logging.WARNING else None)
    try:
        from frontend.settings import dump, load

        config = load(options.config, settings_of(options))
        if options.dump_config:
            print(dump(config), end="")
            return 0
        return run(options, config)
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())

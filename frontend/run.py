"""The command line: `python -m frontend.run [INPUT]`. The one place that wires source, detector, tracker and sinks."""

from __future__ import annotations

import json
import logging
import os
import shlex
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from airline.command import EXIT_USER_ERROR
from airline.errors import AirLineError, ConfigError, InputError
from frontend.flags import build_parser, settings_of
from frontend.terminal import progress, set_up_logging

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from frontend.protocols import Sink, Source
    from frontend.settings import RunConfig
    from frontend.summary import Summary

log = logging.getLogger("frontend.run")

EXIT_INTERRUPTED = 130


def open_input(spec: str | None, config: RunConfig) -> Source:
    """The frames that the input and the frame settings stand for."""
    from frontend.select import select_frames
    from frontend.sources import open_source

    source: Source
    chosen = config.input
    if spec is None:
        from frontend.sources.scene import SceneSource

        source = SceneSource()
    elif Path(spec).suffix.lower() in (".mcap", ".bag"):
        from logs import McapSource

        source = McapSource(spec, topic=chosen.topic)
    else:
        source = open_source(spec, topic=chosen.topic, fps=chosen.fps)
    try:
        return select_frames(
            source,
            start_s=chosen.start,
            end_s=chosen.end,
            stride=chosen.stride,
            max_frames=chosen.max_frames,
            resize=chosen.size,
        )
    except ConfigError:
        source.close()
        raise


def has_display() -> bool:
    """Whether a viewer window could open here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_output(path: Path | None, flag: str, suffix: str) -> None:
    """Refuse an output path before any work; the suffix keeps a slip of the hand from replacing the input."""
    if path is not None and (path.suffix.lower() != suffix or not os.path.isdir(path.parent)):  # noqa: PTH112
        raise InputError(f"cannot write {flag} {path}: give a name that ends with {suffix} in a folder that exists")


def run(options: argparse.Namespace, config: RunConfig) -> int:
    """Run the pipeline until the input ends or Ctrl-C; print and write the summary; returns the exit code."""
    check_output(options.save, "--save", ".rrd")
    check_output(options.summary, "--summary", ".json")
    with closing(open_input(options.input, config)) as source:
        save, viewer = where_to_record(options, source.name)
        code, summary = process(source, config, lambda: [open_recording(save, viewer, source.name, config)])
    from rich.console import Console

    Console().print(summary.table())
    if save is not None and summary.frames:
        print(f"saved {save}; look at it with: rerun {shlex.quote(str(save))}")
    if options.summary is not None:
        write_summary(options.summary, summary)
    return code


def where_to_record(options: argparse.Namespace, name: str) -> tuple[Path | None, str | None]:
    """The file to save, or the address of a viewer: a window where one can open and no file was asked for."""
    if options.save is not None:
        return options.save, None
    if not options.headless and has_display():
        from viz.viewer import open_viewer

        viewer = open_viewer()
        if viewer is not None:
            return None, viewer
        log.warning("no viewer window could be opened: saving %s.rrd instead", name)
    return Path(f"{name}.rrd"), None


def open_recording(save: Path | None, viewer: str | None, name: str, config: RunConfig) -> Sink:
    """The Rerun recording, into a file or a viewer."""
    from viz.rerun_sink import RerunSink

    return RerunSink(
        save=save,
        connect=viewer,
        name=name,
        descriptor_every=config.recording.descriptor_every,
        jpeg_quality=config.recording.jpeg_quality,
    )


def write_summary(path: Path, summary: Summary) -> None:
    """Write the figures as JSON."""
    try:
        path.write_text(json.dumps(summary.to_dict(), indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write --summary {path} ({error.strerror}): choose another file") from None


def process(source: Source, config: RunConfig, open_sinks: Callable[[], list[Sink]]) -> tuple[int, Summary]:
    """Push every frame through detector, tracker and sinks; returns the exit code and the figures.

    Sinks are opened when the first frame has been read, so that a bad input leaves earlier output files alone, and
    are closed whatever happens.
    """
    from airline.detector import AirLine
    from frontend.pipeline import LineFrontend
    from frontend.summary import SummaryCounter
    from frontend.tracker import LineTracker

    frontend = LineFrontend(AirLine(config=config.detector, device=config.device), LineTracker(config.tracker))
    counter = SummaryCounter(config.tracker.confirm_hits)
    sinks: list[Sink] = []
    code = 0
    try:
        with progress(source.name, source.frame_count) as advance:
            for frame in source:
                if not sinks:
                    frontend.warm_up(frame.image)
                    sinks = open_sinks()
                    counter.start()
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
    summary = counter.summary(source.skipped)
    if not summary.frames and code == 0:
        raise InputError(f"{source.name} yields no frame: check the input and --start, --end, --stride")
    return code, summary


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code: 0, 2 for errors a user can mend, 130 after Ctrl-C."""
    options = build_parser().parse_args(arguments)
    # read when torch loads: threads that spin while they wait stall each other when anything else is running
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    set_up_logging(options.verbose)
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

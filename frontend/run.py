"""The command line: `python -m frontend.run [INPUT]`. The one place that wires source, detector, tracker and sinks."""

from __future__ import annotations

import json
import logging
import os
import shlex
import sys
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

from airline.command import EXIT_USER_ERROR
from airline.errors import AirLineError, InputError
from frontend.flags import build_parser, settings_of
from frontend.terminal import progress, set_up_logging

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Iterator

    from frontend.protocols import Sink, Source
    from frontend.settings import RunConfig
    from frontend.summary import Summary

log = logging.getLogger("frontend.run")

EXIT_INTERRUPTED = 130


def open_input(spec: str | None, config: RunConfig) -> Source:
    """The frames that the input, the camera and the frame settings stand for."""
    from frontend.select import select_frames
    from frontend.undistort import with_camera

    chosen = config.input
    camera = None
    if chosen.calib is not None:
        from frontend.calibration import read_calibration

        camera = read_calibration(chosen.calib)
    opened = open_source_of(spec, config)
    try:
        return select_frames(
            with_camera(opened, camera, undistort=chosen.undistort),
            start_s=chosen.start,
            end_s=chosen.end,
            stride=chosen.stride,
            max_frames=chosen.max_frames,
            resize=chosen.size,
        )
    except AirLineError:
        opened.close()
        raise


def open_source_of(spec: str | None, config: RunConfig) -> Source:
    """The input as it is: the built-in clip, a log, or whatever `open_source` takes."""
    from frontend.sources import open_source
    from logs.files import is_log

    if spec is None:
        from frontend.sources.scene import SceneSource

        return SceneSource()
    if is_log(spec):
        from logs import open_images

        return open_images(spec, config.input.topic, time_source=config.input.time_source)
    return open_source(spec, topic=config.input.topic, fps=config.input.fps)


def has_display() -> bool:
    """Whether a viewer window could open here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_output(path: Path | None, flag: str, suffix: str) -> None:
    """Refuse an output path before any work; the suffix keeps a slip of the hand from replacing the input."""
    if path is not None and (path.suffix.lower() != suffix or not os.path.isdir(path.parent)):  # noqa: PTH112
        raise InputError(f"cannot write {flag} {path}: give a name that ends with {suffix} in a folder that exists")


def check_distinct(spec: str | None, outputs: list[Path]) -> None:
    """Refuse to write over the input, or twice into one file."""
    taken = {} if spec is None else {os.path.realpath(spec): "the input"}
    for path in outputs:
        place = os.path.realpath(path)
        if place in taken:
            raise InputError(f"cannot write into {path}: it is {taken[place]}; give another name")
        taken[place] = "another output"


def run(options: argparse.Namespace, config: RunConfig) -> int:
    """Run the pipeline until the input ends or Ctrl-C; print and write the summary; returns the exit code."""
    from logs.sinks.open import check, kind_and_path, open_track_sink

    check_output(options.save, "--save", ".rrd")
    check_output(options.summary, "--summary", ".json")
    for spec in options.out:
        check(spec, overwrite=options.overwrite)
    outputs = [kind_and_path(spec)[1] for spec in options.out]
    check_distinct(options.input, [path for path in (options.save, options.summary, *outputs) if path is not None])

    def open_sinks() -> Iterator[Sink]:
        """One by one, so that those already open are closed when the next one fails."""
        for spec in options.out:
            yield open_track_sink(
                spec, overwrite=options.overwrite, with_images=options.with_images, labels=options.labels
            )
        if save is not None or viewer is not None:
            yield open_recording(save, viewer, source.name, config)

    with closing(open_input(options.input, config)) as source:
        save, viewer = where_to_record(options, source.name)
        code, summary = process(source, config, open_sinks)
    from rich.console import Console

    Console().print(summary.table())
    if save is not None and summary.frames:
        print(f"saved {save}; look at it with: rerun {shlex.quote(str(save))}")
    if summary.frames:
        for spec in options.out:
            print(f"wrote {spec}")
    if options.summary is not None:
        write_summary(options.summary, summary)
    return code


def list_topics(spec: str | None) -> int:
    """Print the cameras of a log; returns the exit code."""
    from logs.files import open_log
    from logs.listing import as_text, camera_topics
    from logs.topics import choose_topic

    if spec is None:
        raise InputError("--list-topics needs a log: name an .mcap file, a .bag file or a bag folder")
    with closing(open_log(spec)) as file:
        rows = camera_topics(file)
        if not rows:
            choose_topic(file.topics, None)  # says what the log holds instead
        print(as_text(rows))
    return 0


def where_to_record(options: argparse.Namespace, name: str) -> tuple[Path | None, str | None]:
    """The file to save, or the address of a viewer: a window where one can open and no file was asked for.

    Without a window the recording goes to a file named after the input, unless --out says where results go.
    """
    if options.save is not None:
        return options.save, None
    if not options.headless and has_display():
        from viz.viewer import open_viewer

        viewer = open_viewer()
        if viewer is not None:
            return None, viewer
        log.warning("no viewer window could be opened%s", "" if options.out else f": saving {name}.rrd instead")
    return (None if options.out else Path(f"{name}.rrd")), None


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


def process(source: Source, config: RunConfig, open_sinks: Callable[[], Iterable[Sink]]) -> tuple[int, Summary]:
    """Push every frame through detector, tracker and sinks; returns the exit code and the figures.

    Sinks are opened when the first frame has been read, so that a bad input leaves earlier output files alone, and
    are closed whatever happens.
    """
    from airline.detector import AirLine
    from frontend.pipeline import LineFrontend
    from frontend.summary import SummaryCounter
    from frontend.tracker import LineTracker

    frontend = LineFrontend(AirLine(config=config.detector, runtime=config.runtime), LineTracker(config.tracker))
    counter = SummaryCounter(config.tracker.confirm_hits)
    sinks: list[Sink] = []
    ready = False
    code = 0
    try:
        with progress(source.name, source.frame_count) as advance, ExitStack() as closing_all:
            for frame in source:
                if not ready:
                    frontend.warm_up(frame.image)
                    for sink in open_sinks():
                        closing_all.callback(sink.close)
                        sinks.append(sink)
                    counter.start()
                    ready = True
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
        if not ready:
            raise
        code = EXIT_USER_ERROR
        print(f"error: {error}", file=sys.stderr)
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
        if options.list_topics:
            return list_topics(options.input)
        return run(options, config)
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())

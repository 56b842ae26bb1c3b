"""The command line: `python -m frontend.run [INPUT]`. The one place that wires source, detector, tracker and sinks."""

from __future__ import annotations

import json
import logging
import os
import shlex
import sys
import time
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from airline.command import EXIT_USER_ERROR, print_errors
from airline.errors import AirLineError, ConfigError, InputError
from frontend.cli.flags import build_parser, settings_of
from frontend.cli.signals import ending_like_interrupts, exit_code_of, uninterrupted
from frontend.cli.terminal import progress, set_up_logging
from frontend.cli.wiring import open_input, open_recording

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Iterator

    from frontend.cli.settings import RunConfig
    from frontend.cli.summary import Summary, SummaryCounter
    from frontend.frame import Frame
    from frontend.pipeline import LineFrontend
    from frontend.protocols import Sink, Source
    from viz.viewer import WebViewer

log = logging.getLogger("frontend.run")


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
    from logs.live.address import parse_address
    from logs.sinks.open import check, kind_and_path, open_publisher, open_track_sink

    video = video_to_log(options.input, config)
    check_output(options.save, "--save", ".rrd")
    check_output(options.summary, "--summary", ".json")
    for spec in options.out:
        check(spec, overwrite=options.overwrite)
    for address in options.publish:
        parse_address(address)
    outputs = [kind_and_path(spec)[1] for spec in options.out]
    check_distinct(options.input, [path for path in (options.save, options.summary, *outputs) if path is not None])

    def open_sinks() -> Iterator[Sink]:
        """One by one, so that those already open are closed when the next one fails."""
        yield from publishers  # first, so that nobody there waits for the others
        for spec in options.out:
            yield open_track_sink(
                spec, overwrite=options.overwrite, with_images=options.with_images, labels=options.labels
            )
        if save is not None or viewer is not None:
            yield open_recording(save, viewer, source.name, config, video)

    with ExitStack() as serving:
        server = serving.enter_context(web_viewer()) if options.serve else None
        with closing(open_input(options.input, config)) as source, ExitStack() as publishing:
            publishers = [
                publishing.enter_context(closing(open_publisher(address, source.name, labels=options.labels)))
                for address in options.publish
            ]
            for publisher in publishers:
                print(f"publishing at {publisher.address}", flush=True)
            save, viewer = where_to_record(options, source.name, server)
            if options.input is None:
                from frontend.warm_up import compile_ahead

                compile_ahead()  # while the renderer is compiled here
            code, summary = process(source, config, open_sinks)
        report(options, save, summary)
        if server is not None and code == 0:
            wait_for_interrupt(server)
    return code


def report(options: argparse.Namespace, save: Path | None, summary: Summary) -> None:
    """Print the figures and what was written where."""
    from rich.console import Console

    from logs.sinks.open import kind_and_path

    Console().print(summary.table())
    if options.input is None and summary.frames:
        print("the built-in clip is rendered while it runs, which takes most of the time: videos are faster")
    if save is not None and summary.frames and save.exists():
        print(f"saved {save}; look at it with: rerun {shlex.quote(str(save))}")
    if summary.frames:
        for spec in options.out:
            if kind_and_path(spec)[1].exists():  # it may have been removed, or have been left unfinished
                print(f"wrote {spec}")
    if options.summary is not None:
        write_summary(options.summary, summary)


def video_to_log(spec: str | None, config: RunConfig) -> Path | None:
    """The input's file if it stands for the frames in the recording."""
    if config.recording.image != "video":
        return None
    if config.input.resize is not None or config.input.undistort:
        raise ConfigError("--log-image video shows frames as they are in the file: leave --resize and --undistort out")
    if spec is None:
        raise ConfigError("--log-image video needs a video file as its input: name one, or use --log-image jpeg")
    return Path(spec)


@contextmanager
def web_viewer() -> Iterator[WebViewer | None]:
    """A viewer for browsers, while the block runs; None, and a warning, where it does not start."""
    from viz.viewer import serve

    viewer = serve()
    if viewer is None:
        log.warning("no web viewer could be started: going on without it")
        yield None
        return
    print(f"watch at {viewer.url}", f"or with: rerun {viewer.stream}", sep="\n", flush=True)
    try:
        yield viewer
    finally:
        viewer.close()


def wait_for_interrupt(viewer: WebViewer) -> None:
    """Keep the web viewer up until Ctrl-C, or until it ends by itself."""
    try:
        print(f"serving at {viewer.url} until Ctrl-C", flush=True)
        viewer.process.wait()
    except KeyboardInterrupt:
        return
    log.warning("the web viewer has ended")


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


def where_to_record(
    options: argparse.Namespace, name: str, server: WebViewer | None = None
) -> tuple[Path | None, str | None]:
    """The file to save and the address of a viewer: the one that was asked for, or a window where one can open.

    Without either the recording goes to a file named after the input, unless --out or --publish says where results go.
    """
    elsewhere = options.out or options.publish
    if options.connect is not None or server is not None:
        return options.save, options.connect if server is None else server.stream
    if options.spawn or (options.save is None and not options.headless and not options.serve and has_display()):
        from viz.viewer import open_viewer

        viewer = open_viewer()
        if viewer is not None:
            return options.save, viewer
        saved = options.save is not None or elsewhere
        log.warning("no viewer window could be opened%s", "" if saved else f": saving {name}.rrd instead")
    if options.save is not None:
        return options.save, None
    return (None if elsewhere else Path(f"{name}.rrd")), None


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
    from frontend.cli.summary import SummaryCounter
    from frontend.pipeline import open_frontend
    from frontend.protocols import is_live, reconnects_of
    from frontend.sources.fresh import FreshFrames
    from frontend.sources.realtime import RealtimeSource

    frontend = open_frontend(config)
    counter = SummaryCounter(config.tracker.confirm_hits)
    fresh = None
    if is_live(source) and not config.serial:
        fresh = FreshFrames(source, config.input.max_latency, hold=isinstance(source, RealtimeSource))
    ready = False
    code = 0

    def open_all() -> Iterator[Sink]:
        nonlocal ready
        yield from open_sinks()
        ready = True

    try:
        with progress(source.name, source.frame_count) as advance:
            push(fresh or source, frontend, open_all, counter, serial=config.serial, advance=advance)
    except KeyboardInterrupt as interrupt:
        code = exit_code_of(interrupt)
        log.warning("interrupted: what was done so far is kept")
    except AirLineError as error:
        if not ready:
            raise
        code = EXIT_USER_ERROR
        print_errors(error)
    summary = counter.summary(source.skipped, fresh.dropped if fresh else 0, reconnects_of(source))
    if code == 0:
        check_frames(source, summary)
    return code, summary


def push(
    source: Source,
    frontend: LineFrontend,
    open_sinks: Callable[[], Iterable[Sink]],
    counter: SummaryCounter,
    *,
    serial: bool = False,
    advance: Callable[[], None] = lambda: None,
) -> None:
    """Push every frame through detector, tracker, sinks and counter, then close the source and the sinks.

    Args:
        source: the frames; closed whatever happens.
        frontend: detector and tracker.
        open_sinks: called when the first frame has been read; what it yields is closed whatever happens.
        counter: counts the frames, from when the sinks are open.
        serial: see `LineFrontend.results`.
        advance: called after each frame.

    Raises:
        AirLineError: the source or a sink cannot be used, or not any longer.
    """
    from frontend.protocols import stopping

    sinks: list[Sink] = []

    def finish(sink: Sink) -> None:
        with uninterrupted():
            sink.close()

    def prepare(frame: Frame) -> None:
        frontend.warm_up(frame.image)
        for sink in open_sinks():
            closing_all.callback(finish, sink)
            sinks.append(sink)
        counter.start()

    with (
        closing(source),
        ExitStack() as closing_all,
        closing(frontend.results(source, serial=serial, prepare=prepare)) as results,
        stopping(source),
    ):
        for result in results:
            with uninterrupted():  # a frame is in all of them, or in none
                started = time.perf_counter()
                for sink in sinks:
                    sink.write(result)
                counter.add(result)
                counter.add_time({"sinks": 1e3 * (time.perf_counter() - started)})
            advance()


def check_frames(source: Source, summary: Summary) -> None:
    """Refuse to call it a run when there was no frame; raises InputError."""
    if not summary.frames:
        raise InputError(f"{source.name} yields no frame: check the input and --start, --end, --stride")


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code: 0, 2 for errors a user can mend, 130 after Ctrl-C, 143 after SIGTERM."""
    options = build_parser().parse_args(arguments)
    # read when torch loads: threads that spin while they wait stall each other when anything else is running
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    set_up_logging(options.verbose)
    try:
        from frontend.cli.settings import dump, load

        config = load(options.config, settings_of(options))
        if options.dump_config:
            print(dump(config), end="")
            return 0
        if options.list_topics:
            return list_topics(options.input)
        with ending_like_interrupts():
            return run(options, config)
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt as interrupt:
        return exit_code_of(interrupt)


if __name__ == "__main__":
    sys.exit(main())

"""The command line: `python -m frontend.run [INPUT]`. What happens with each frame is told in `frontend.pipeline`."""

from __future__ import annotations

import json
import logging
import os
import shlex
import sys
from contextlib import ExitStack, closing
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from airline.command import EXIT_USER_ERROR, print_errors
from airline.errors import AirLineError, ConfigError, InputError
from frontend.cli import wiring
from frontend.cli.flags import build_parser, settings_of
from frontend.cli.signals import ending_like_interrupts, exit_code_of, ignore_more
from frontend.cli.terminal import progress, set_up_logging

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Iterator

    from frontend.cli.settings import RunConfig
    from frontend.cli.summary import Summary
    from frontend.frame import Frame
    from frontend.protocols import FrameResult, Sink, Source

log = logging.getLogger("frontend.run")

EXIT_BROKEN_PIPE = 141


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code: 0, 2 for errors a user can mend, 130 after Ctrl-C, 143 after SIGTERM."""
    options = build_parser().parse_args(arguments)
    # read when torch loads: threads that spin while they wait stall each other when anything else is running
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    set_up_logging(options.verbose)
    code = 0
    try:
        from frontend.cli.settings import dump, load

        config = load(options.config, settings_of(options))
        if options.dump_config:
            print(dump(config), end="")
        elif options.list_topics:
            print(wiring.list_topics(options.input))
        elif options.info:
            from frontend.cli.info import describe

            with closing(wiring.open_input(options.input, config)) as source:
                print(describe(source))
        else:
            with ending_like_interrupts():
                code = run(options, config)
        sys.stdout.flush()
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt as interrupt:
        return exit_code_of(interrupt)
    except BrokenPipeError:  # of `| head`: nobody reads what is left, nor would Python's own flush at the end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    return code


def run(options: argparse.Namespace, config: RunConfig) -> int:
    """Run the pipeline until the input ends or Ctrl-C, print and write the summary; returns the exit code."""
    from frontend.cli.info import introduce, properties

    video = wiring.video_to_log(options.input, config)
    track_files = wiring.track_files(options.out, overwrite=options.overwrite, points=config.tracker.points)
    check_outputs(options, chain(*track_files), config.input.right)

    with ExitStack() as stack:
        server = stack.enter_context(wiring.web_viewer()) if options.serve else None
        with ExitStack() as opened:
            source = opened.enter_context(closing(wiring.open_input(options.input, config)))
            stride = config.input.stride
            publishers = []
            for address in options.publish:
                publisher = wiring.open_publisher(address, source.name, labels=options.labels, stride=stride)
                publishers.append(opened.enter_context(closing(publisher)))
            for publisher in publishers:
                print(f"publishing at {publisher.address}", flush=True)
            save, viewer = wiring.where_to_record(options, source.name, server)
            if config.recording.layer is not None and save is None and viewer is None:
                raise ConfigError("a layer goes into a recording: give --save FILE.rrd or a viewer")

            said = 0
            ours: list[str] = [*filter(None, map(wiring.guess_of, options.out))]

            def sinks(first: Frame) -> Iterator[Sink]:  # opens them
                nonlocal said
                turned = video is not None and not source.orientation.startswith("as stored")
                if turned:
                    ours.append("Rerun does not turn videos, so the recording has the frames as JPEGs")
                results = [*_written(save, track_files), *filter(None, [viewer and f"into the viewer at {viewer}"])]
                notes = [*source.notes, *ours]
                print(introduce(source, first, notes, results, found=not config.input.calib), flush=True)
                said = len(source.notes)
                yield from publishers  # first, so that nobody there waits for the others
                for spec in options.out:
                    yield wiring.open_track_sink(
                        spec,
                        overwrite=options.overwrite,
                        with_images=options.with_images,
                        labels=options.labels,
                        stride=stride,
                        points=config.tracker.points,
                    )
                if save is not None or viewer is not None:
                    facts = properties(options.input, source, first, config, notes)
                    yield wiring.open_recording(save, viewer, source.name, config, None if turned else video, facts)

            code, summary = process(source, config, sinks)
        late = summary.notes[said:]
        summary.notes.extend(ours)
        report(options, summary, late, save, track_files)
        if server is not None and code == 0:
            wiring.wait_for_interrupt(server)
    return code


def process(
    source: Source, config: RunConfig, sinks: Iterable[Sink] | Callable[[Frame], Iterable[Sink]]
) -> tuple[int, Summary]:
    """`run_pipeline` with these settings until the source ends or Ctrl-C; returns the exit code and the figures.

    Raises:
        AirLineError: before all sinks were open; later it is printed, and what was done so far is kept.
    """
    from frontend.cli.summary import SummaryCounter
    from frontend.pipeline import open_frontend, run_pipeline
    from frontend.warm_up import compile_ahead

    if compile_ahead():
        print("compiling for this processor, once: a quarter of a minute to a whole one", flush=True)
    frontend = open_frontend(config)
    counter = SummaryCounter(config.tracker.confirm_hits)
    code = 0
    try:
        with progress(source.name, source.frame_count) as advance:

            def show(result: FrameResult) -> None:
                dropped = f", {source.dropped} dropped" if source.dropped else ""
                advance(f"{len(result.trace.lines)} lines, {len(result.tracks)} tracks{dropped}")

            run_pipeline(source, frontend, sinks, counter, serial=config.serial, advance=show)
    except KeyboardInterrupt as interrupt:
        code = exit_code_of(interrupt)
        log.warning("interrupted: what was done so far is kept")
    except AirLineError as error:
        if not counter.started:
            raise
        code = EXIT_USER_ERROR
        print_errors(error)
    return code, counter.summary(source)


def _written(save: Path | None, track_files: Iterable[list[Path]]) -> list[str]:
    """The files of a run, each with a word where one is replaced."""
    paths = [*([] if save is None else [save]), *(files[0] for files in track_files)]
    there = [os.path.exists(path) for path in paths]  # noqa: PTH110  pathlib raises for long names
    return [f"{path}{' (in place of the one that is there)' * old}" for path, old in zip(paths, there, strict=True)]


def check_outputs(options: argparse.Namespace, track_files: Iterable[Path], right: str | None) -> None:
    """Refuse, before any work, what cannot be written, and to write over the input or twice into one file."""
    for flag, path, suffix in (("--save", options.save, ".rrd"), ("--summary", options.summary, ".json")):
        # the suffix keeps a slip of the hand from replacing the input
        if path is not None and (
            path.suffix.lower() != suffix or os.path.isdir(path) or not os.path.isdir(path.parent)  # noqa: PTH112
        ):
            raise InputError(f"cannot write {flag} {path}: give a name that ends with {suffix} in a folder that exists")
    taken = {os.path.realpath(path): "the input" for path in (options.input, right) if path is not None}
    for path in (options.save, options.summary, *track_files):
        place = path and os.path.realpath(path)
        if place in taken:
            raise InputError(f"cannot write into {path}: it is {taken[place]}; give another name")
        if place is not None:
            taken[place] = "another output"


def report(
    options: argparse.Namespace, summary: Summary, notes: list[str], save: Path | None, track_files: list[list[Path]]
) -> None:
    """Write the --summary; print the notes that came late, the figures and what was written where."""
    from rich.console import Console

    # before anything is printed to somebody who may not listen any more
    error = None if options.summary is None else write_summary(options.summary, summary)
    for note in notes:
        print(f"note: {note}")
    console = Console()
    with console.capture() as table:
        console.print(summary.table(boxed=console.is_terminal))
    print(table.get(), end="")
    if summary.frames:
        if save is not None and save.exists():
            print(f"saved {save}; look at it with: rerun {shlex.quote(str(save))}")
        for spec, files in zip(options.out, track_files, strict=True):
            if files[0].exists():  # it may have been removed, or have been left unfinished
                look = f"; look at it with: python -m viz.replay {shlex.quote(str(files[0]))}"
                print(f"wrote {spec}{look if wiring.can_be_replayed(spec) else ''}")
    if error is not None:
        raise error


def write_summary(path: Path, summary: Summary) -> InputError | None:
    """Write the figures as JSON; returns why that cannot be done."""
    try:
        path.write_text(json.dumps(summary.to_dict(), indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        return InputError(f"cannot write --summary {path} ({error.strerror}): choose another file")
    return None


if __name__ == "__main__":
    code = main()
    ignore_more(code)
    sys.exit(code)

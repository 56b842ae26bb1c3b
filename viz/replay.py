"""A file with tracks as a recording: `python -m viz.replay tracks.parquet [--save tracks.rrd | --connect HOST:PORT]`.

Takes what `frontend.run --out` writes: .mcap, with its images where `--with-images` put them in, .parquet, and the
.parquet.unfinished of a run that was killed. Without a flag it opens a viewer's window.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import chain
from pathlib import Path
from typing import Generic, TypeVar

import rerun as rr
import rerun.blueprint as rrb

from airline.command import Parser, exit_code
from airline.errors import InputError
from airline.image import to_uint8
from frontend.frame import Frame
from frontend.tracks import LineTracks
from viz.blueprint import layout
from viz.destination import Destination, open_stream
from viz.figures import Clock, FigureLog, track_figures
from viz.lines import TrackLog, picture_size, pinhole
from viz.rerun_private import jpeg, send_blueprint
from viz.viewer import open_viewer

JPEG_QUALITY = 90  # the images are compressed a second time

T = TypeVar("T", LineTracks, Frame)


class ByStamp(Generic[T]):
    """Frames in the order of their stamps, asked for by ascending stamps."""

    def __init__(self, frames: Iterator[T]) -> None:
        self._frames: Iterator[T] = frames
        self._next: T | None = next(frames, None)
        self.empty = self._next is None

    def at(self, stamp_ns: int) -> T | None:
        """The frame with this stamp, None where there is none."""
        while self._next is not None and self._next.stamp_ns < stamp_ns:
            self._next = next(self._frames, None)
        return self._next if self._next is not None and self._next.stamp_ns == stamp_ns else None


def images_of(path: Path, *, right: bool = False) -> Iterator[Frame]:
    """The images, or right images, that `--with-images` put into a log of tracks, if it did."""
    from logs import open_images
    from logs.sinks.foxglove import IMAGE_TOPIC, RIGHT_IMAGE_TOPIC

    if path.suffix.lower() != ".mcap":
        return
    try:
        topic = RIGHT_IMAGE_TOPIC if right else IMAGE_TOPIC
        source = open_images(path, topic, time_source="log")  # where the sink writes the frame's stamp
    except InputError:  # the log has no such topic; where it cannot be read, those who read its tracks will say so
        return
    with closing(source):
        yield from source


def log_image(stream: rr.RecordingStream, image: Frame | None, entity: str = "/camera/image") -> None:
    """Log a frame's image, if there is one."""
    if image is not None:
        stream.log(entity, jpeg(to_uint8(image.image), JPEG_QUALITY))


@contextmanager
def recording(
    application_id: str, name: str, blueprint: rrb.Blueprint, save: Path | None, connect: str | None
) -> Iterator[rr.RecordingStream]:
    """A recording into a file, a running viewer or both, or else into a viewer's window; finished behind the block.

    Raises:
        InputError: the file cannot be written, no viewer answers, or no window can open.
    """
    if save is not None and (save.suffix.lower() != ".rrd" or not save.parent.is_dir()):
        raise InputError(f"cannot write --save {save}: give a name that ends with .rrd in a folder that exists")
    if save is None and connect is None:
        connect = open_viewer()
        if connect is None:
            raise InputError("no viewer window could be opened: give a file with --save FILE.rrd")
    stream = open_stream(application_id, live=connect is not None)
    with closing(Destination(stream, save, connect)) as destination:
        if not destination.alive:
            raise InputError(f"there is no viewer at {connect}: start one, or give a file with --save FILE.rrd")
        stream.send_recording_name(name)
        send_blueprint(stream, blueprint)
        yield stream


def replay(path: Path, save: Path | None, connect: str | None, *, show_lost: bool = False) -> int:
    """Record a file with tracks, as far as it can be read; returns how many frames it has.

    Args:
        path: the file.
        save: .rrd file to write.
        connect: address of a running viewer, `HOST:PORT`.
        show_lost: see `RerunSink`.

    Raises:
        InputError: the file cannot be read, the recording cannot be written, or no window can open.
    """
    from logs import read_tracks

    frames, images, rights = read_tracks(path), ByStamp(images_of(path)), ByStamp(images_of(path, right=True))
    first = next(frames, None)
    shown = layout("minimal", image=not images.empty, right=first is not None and len(first.right_hits) > 0)
    count = 0
    with recording("airline-frontend", path.stem, shown, save, connect) as stream:
        clock, figures = Clock(stream), FigureLog(stream)
        lines, size = TrackLog(stream, show_lost=show_lost), None
        for tracks in chain([] if first is None else [first], frames):
            clock.set(tracks.frame_index, tracks.stamp_ns)
            if not count and tracks.camera is not None:
                stream.log("/camera", pinhole(tracks.camera), static=True)
            image = images.at(tracks.stamp_ns)
            log_image(stream, image)
            log_image(stream, rights.at(tracks.stamp_ns), "/right/image")
            size = size or picture_size(tracks, None if image is None else image.image)
            lines.write(tracks, size)
            if tracks.reset is not None:
                stream.log("/log", rr.TextLog(f"all tracks ended: {tracks.reset}", level="WARN"))
            figures.write(track_figures(tracks))
            count += 1
    return count


def run(options: argparse.Namespace) -> None:
    """Do what the flags ask for."""
    count = replay(options.file, options.save, options.connect, show_lost=options.show_lost)
    if options.save is not None:
        print(f"saved {options.save} with {count} frames; look at it with: rerun {options.save}")


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = Parser(prog="python -m viz.replay", description="Turns a file with tracks into a Rerun recording.")
    parser.add_argument("file", type=Path, help=".mcap, .parquet or .parquet.unfinished file with tracks")
    parser.add_argument("--save", type=Path, metavar="FILE.rrd", help="record into this file")
    parser.add_argument("--connect", metavar="HOST:PORT", help="show in a viewer that runs already")
    parser.add_argument("--show-lost", action="store_true", help="draw lost lines for as long as they are looked for")
    return exit_code(run, parser.parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())

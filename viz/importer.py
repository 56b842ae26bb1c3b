"""An importer for the Rerun viewer: files with tracks, opened like recordings.

The viewer starts every executable on the PATH whose name begins with `rerun-importer-` for each file whose ending it
does not know; the importer writes a recording to stdout, or ends with 66 where a file is not its own. The viewer takes
files that end with .mcap and .parquet for its own, so those go through a pipe, or straight into a window:

    rerun-importer-airline tracks.parquet | rerun -
    rerun-importer-airline tracks.parquet

Nothing but the standard library is loaded until a file is known to be ours.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from airline.command import EXIT_USER_ERROR, Parser
from viz.track_files import kind_of

if TYPE_CHECKING:
    from collections.abc import Callable

    import rerun as rr

NOT_MINE = 66  # of Rerun's protocol
APPLICATION = "airline-frontend"


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code: 0, 66 for files of others, 2 for damaged files and other errors."""
    options, _ = _parser().parse_known_args(arguments)  # later versions of Rerun may pass more
    if kind_of(options.file) is None:
        return NOT_MINE
    from airline.errors import AirLineError

    if options.static:
        print("tracks have times of their own: --static is not for them", file=sys.stderr)
    try:
        write_recording(options)
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    return 0


def write_recording(options: argparse.Namespace) -> None:
    """The file's tracks as a recording on stdout, or in a window where stdout is a terminal.

    What was read before an error is written. Raises InputError for a damaged file, or where no window can open.
    """
    import rerun as rr

    from logs import read_tracks
    from viz.blueprint import layout
    from viz.track_files import images_of
    from viz.track_recording import TrackRecorder, paired

    stream = rr.RecordingStream(options.application_id or APPLICATION, recording_id=options.recording_id)
    stream.set_log_time_enabled(False)
    if sys.stdout.isatty():
        close = _into_a_window(stream)
    else:
        stream.stdout()
        close = stream.disconnect
    prefix = "/" + options.entity_path_prefix.strip("/") if options.entity_path_prefix else ""
    if not prefix:  # the layout knows the paths without one
        stream.send_blueprint(layout("minimal"))
    stream.send_recording_name(options.file.stem)
    try:
        _set_times(stream, options)
        recorder = TrackRecorder(stream, prefix)
        for tracks, image in paired(read_tracks(options.file), images_of(options.file)):
            recorder.write(tracks, image)
    finally:
        close()


def _into_a_window(stream: rr.RecordingStream) -> Callable[[], None]:
    """Connect to a viewer; returns what ends that."""
    from airline.errors import InputError
    from viz.destination import Destination
    from viz.viewer import open_viewer

    address = open_viewer()
    if address is None:
        raise InputError("no viewer window could be opened: write the recording to a file with > tracks.rrd")
    return Destination(stream, None, address).close


def _set_times(stream: rr.RecordingStream, options: argparse.Namespace) -> None:
    """The times that the viewer asks for, beside the tracks' own."""
    import numpy as np

    for text in options.time_sequence:
        timeline, _, value = text.rpartition("=")
        stream.set_time(timeline, sequence=int(value))
    for text in options.time_duration_nanos:
        timeline, _, value = text.rpartition("=")
        stream.set_time(timeline, duration=np.timedelta64(int(value), "ns"))
    for text in options.time_timestamp_nanos:
        timeline, _, value = text.rpartition("=")
        stream.set_time(timeline, timestamp=np.datetime64(int(value), "ns"))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="rerun-importer-airline", description="Opens files with tracks in the Rerun viewer.")
    parser.add_argument("file", type=Path, help=".mcap, .parquet or .parquet.unfinished file with tracks")
    viewer = parser.add_argument_group("what the viewer passes")
    viewer.add_argument("--application-id", metavar="ID", help="of the recording")
    viewer.add_argument("--recording-id", metavar="ID", help="of the recording")
    viewer.add_argument("--opened-application-id", metavar="ID", help="not used: each file is a recording of its own")
    viewer.add_argument("--opened-recording-id", metavar="ID", help="not used")
    viewer.add_argument("--entity-path-prefix", metavar="PATH", help="before all entity paths")
    viewer.add_argument("--static", action="store_true", help="not used: tracks have times")
    for kind in ("sequence", "duration_nanos", "timestamp_nanos"):
        viewer.add_argument(f"--time_{kind}", nargs="*", action="extend", default=[], metavar="TIMELINE=N")
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""A picture of the real viewer, without a screen: `python -m viz.snapshot run.rrd --frame 30 picture.png`.

Needs a Vulkan driver; a software one will do (Debian: mesa-vulkan-drivers and libvulkan1). With `--plain`, OpenCV draws
the image and its tracks instead, and needs no driver; `--video film.mp4` makes a film of such pictures.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rerun.experimental import ViewerClient, ViewerState

from airline.command import Parser, exit_code
from airline.errors import InputError
from viz.overlay import draw_frame, write_film, write_picture
from viz.recording import Recording
from viz.viewer import Viewer, free_port, start, stop

POLL_S = 0.2


def save_picture(
    recording: Path,
    picture: Path,
    *,
    frame: int | None = None,
    size: tuple[int, int] = (1920, 1080),
    timeout_s: float = 60.0,
) -> list[str]:
    """Open a recording in a headless viewer and save what it shows at a frame; None is the last.

    Returns:
        What the views of the viewer complain about, one sentence each; empty when all is well.

    Raises:
        InputError: no such recording, no such frame, no graphics driver, an unwritable picture, or out of time.
    """
    if not recording.is_file():
        raise InputError(f"there is no recording {recording}: give an .rrd file")
    if not picture.parent.is_dir():
        raise InputError(f"cannot write {picture}: create its folder first")
    with headless_viewer(recording, size, timeout_s) as client:
        state = wait_until_loaded(client, recording)
        client.run_command("ui.toggle_top_panel")  # menus and driver warnings are no part of the picture
        show_frame(client, state, frame, picture)
        views = client.get_state().views
    return [f"{view.name}: {report.summary}" for view in views for report in view.reports]


@contextmanager
def headless_viewer(recording: Path, size: tuple[int, int], timeout_s: float) -> Iterator[ViewerClient]:
    """A viewer that opens the recording; it is gone when the block ends, or, at the latest, after the timeout."""
    port = free_port()
    flags = ("--headless", "--window-size", f"{size[0]}x{size[1]}", str(recording))
    with tempfile.TemporaryFile() as output:
        viewer = start(port, *flags, output=output.fileno(), RUST_LOG="error")
        if viewer is None:
            raise InputError("Rerun's viewer is not installed beside this Python: take a plain picture with --plain")
        watchdog = threading.Timer(timeout_s, stop, [viewer])
        watchdog.start()
        try:
            yield _connect(viewer, port)
        except ConnectionError as reason:
            time.sleep(POLL_S)
            output.seek(0)
            said = output.read().decode(errors="replace").split("\n")
            if any("graphics adapter" in line or "render context" in line for line in said):
                raise InputError(
                    "the viewer found no graphics driver: install a Vulkan driver, such as Debian's "
                    "mesa-vulkan-drivers, or take a plain picture with --plain"
                ) from reason
            last = next((line.strip() for line in reversed(said) if line.strip()), "")
            raise InputError(
                f"the viewer ended or gave no picture within {timeout_s:g} s: try a longer timeout ({last})"
            ) from reason
        finally:
            watchdog.cancel()
            stop(viewer)


def _connect(viewer: Viewer, port: int) -> ViewerClient:
    while True:
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
        except ConnectionError:
            if viewer.poll() is not None:
                raise
            time.sleep(POLL_S)
        else:
            return client


def wait_until_loaded(client: ViewerClient, recording: Path) -> ViewerState:
    """What the viewer holds, when it holds all of the recording; InputError where it cannot read it."""
    while True:
        state = client.get_state()
        if state.recordings and not state.loading and all(r.timelines for r in state.recordings):
            return state
        if any(entry.level == "ERROR" for entry in client.get_logs()):
            raise InputError(f"the viewer cannot read {recording}: it is damaged or was cut short, record it again")
        time.sleep(POLL_S)


def show_frame(client: ViewerClient, state: ViewerState, frame: int | None, picture: Path) -> None:
    """Go to a frame, None is the last, and save what the viewer shows when it has settled."""
    timeline = next((t for r in state.recordings for t in r.timelines if t.name == "frame"), None)
    if timeline is None or timeline.start is None or timeline.end is None:
        raise InputError("the recording has no timeline 'frame': give one that was written by this project")
    if frame is None:
        frame = timeline.end
    if not timeline.start <= frame <= timeline.end:
        raise InputError(f"there is no frame {frame}: choose one from {timeline.start} to {timeline.end}")
    client.set_time("frame", sequence=frame, play_state="paused")
    before, now = b"none yet", b""
    while now != before:  # images are decoded and views fade in after the first paint
        client.save_screenshot(str(picture.absolute()))
        before, now = now, picture.read_bytes()


def save_overlay(recording: Path, picture: Path, *, frame: int | None = None) -> None:
    """Draw image and tracks of a frame, None is the last, with OpenCV in the colours of the recording.

    Raises:
        InputError: no such recording, no such frame, or an unwritable picture.
    """
    opened = Recording(recording)
    chosen = opened.at(opened.indices[-1] if frame is None else frame)
    write_picture(picture, draw_frame(next(opened.frames(chosen, chosen))))


def save_film(recording: Path, film: Path, *, start: int | None = None, end: int | None = None) -> int:
    """Make an .mp4 of image and tracks from frame `start` to `end`, at the recording's rate; returns its length.

    Raises:
        InputError: no such recording, no frame between these, or an unwritable film.
    """
    if film.suffix.lower() != ".mp4":
        raise InputError(f"cannot write {film}: films are .mp4 files")
    opened = Recording(recording)
    first, last = opened.indices[0], opened.indices[-1]
    if not any((start or first) <= frame <= (last if end is None else end) for frame in opened.indices):
        raise InputError(f"there is no frame from {start} to {end}: choose frames from {first} to {last}")
    return write_film(film, map(draw_frame, opened.frames(start, end)), opened.fps)


def run(options: argparse.Namespace) -> None:
    """Do what the flags ask for, and print what the viewer complains about."""
    if options.video is not None:
        save_film(options.recording, options.video, start=options.start, end=options.end)
    if options.picture is not None and options.plain:
        save_overlay(options.recording, options.picture, frame=options.frame)
    elif options.picture is not None:
        how = {"frame": options.frame, "size": tuple(options.size), "timeout_s": options.timeout}
        for complaint in save_picture(options.recording, options.picture, **how):
            print(f"the viewer reports: {complaint}", file=sys.stderr)


def main() -> int:
    """Command line; returns the exit code."""
    parser = Parser(prog="python -m viz.snapshot", description="Pictures of a recording, without a screen.")
    parser.add_argument("recording", type=Path, help=".rrd file")
    parser.add_argument("picture", type=Path, nargs="?", help=".png file to write")
    parser.add_argument("--frame", type=int, help="which frame to show (default: the last)")
    parser.add_argument("--size", type=int, nargs=2, default=(1920, 1080), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--timeout", type=float, default=60.0, metavar="SECONDS")
    parser.add_argument("--plain", action="store_true", help="draw image and tracks alone, without the viewer")
    parser.add_argument("--video", type=Path, metavar="FILE.mp4", help="write a film of image and tracks")
    parser.add_argument("--start", type=int, metavar="N", help="first frame of the film")
    parser.add_argument("--end", type=int, metavar="N", help="last frame of the film")
    options = parser.parse_args()
    if options.picture is None and options.video is None:
        parser.error("name the picture to write, or a film with --video")
    return exit_code(run, options)


if __name__ == "__main__":
    sys.exit(main())

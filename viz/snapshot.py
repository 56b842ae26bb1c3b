"""A picture of the real viewer, without a screen: `python -m viz.snapshot run.rrd --frame 30 picture.png`.

Needs a Vulkan driver; a software one will do (Debian: mesa-vulkan-drivers and libvulkan1). With `--plain`, OpenCV draws
the image and its tracks instead, and needs no driver; `--video film.mp4` makes a film of such pictures.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rerun.experimental import ViewerClient, ViewerState

from airline.command import EXIT_USER_ERROR, Parser
from airline.errors import AirLineError, InputError
from viz.viewer import environment

POLL_S = 0.2


def save_picture(
    recording: Path,
    picture: Path,
    *,
    frame: int | None = None,
    size: tuple[int, int] = (1920, 1080),
    timeout_s: float = 60.0,
) -> list[str]:
    """Open a recording in a headless viewer and save what it shows.

    Args:
        recording: .rrd file.
        picture: .png file to write.
        frame: where to put the cursor on the timeline `frame`; None is its last frame.
        size: width and height of the viewer, px.
        timeout_s: the viewer is stopped after so many seconds.

    Returns:
        What the views of the viewer complain about, one sentence each; empty when all is well.

    Raises:
        InputError: no such recording, no such frame, no graphics driver, an unwritable picture, or out of time.
    """
    if not recording.is_file():
        raise InputError(f"there is no recording {recording}: give an .rrd file")
    if not picture.parent.is_dir():
        raise InputError(f"cannot write {picture}: create its folder first")
    with _headless_viewer(recording, size, timeout_s) as client:
        state = _wait_until_loaded(client, recording)
        _go_to(client, state, frame)
        client.run_command("ui.toggle_top_panel")  # menus and driver warnings are no part of the picture
        _save_settled(client, picture)
        views = client.get_state().views
    return [f"{view.name}: {report.summary}" for view in views for report in view.reports]


@contextmanager
def _headless_viewer(recording: Path, size: tuple[int, int], timeout_s: float) -> Iterator[ViewerClient]:
    """A viewer that shows the recording; it is gone when the block ends, or, at the latest, after the timeout."""
    port = _free_port()
    command = [str(Path(sys.executable).parent / "rerun"), "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--window-size", f"{size[0]}x{size[1]}", str(recording)]
    with tempfile.TemporaryFile() as output:
        viewer = subprocess.Popen(
            command,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**environment(), "RUST_LOG": "error"},
            start_new_session=True,  # `rerun` is a launcher: its child, the viewer itself, has to end with it
        )
        watchdog = threading.Timer(timeout_s, _stop, [viewer])
        watchdog.start()
        try:
            yield _connect(viewer, port)
        except ConnectionError as reason:
            time.sleep(POLL_S)
            output.seek(0)
            raise InputError(_why_it_ended(output.read().decode(errors="replace"), timeout_s)) from reason
        finally:
            watchdog.cancel()
            _stop(viewer)
            viewer.wait()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _stop(viewer: subprocess.Popen[bytes]) -> None:
    if viewer.poll() is None:
        os.killpg(viewer.pid, signal.SIGKILL)


def _connect(viewer: subprocess.Popen[bytes], port: int) -> ViewerClient:
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


def _why_it_ended(output: str, timeout_s: float) -> str:
    if "graphics adapter" in output or "render context" in output:
        return (
            "the viewer found no graphics driver: install a Vulkan driver, such as Debian's mesa-vulkan-drivers, "
            "or take a plain picture with --plain"
        )
    last = next((line for line in reversed(output.splitlines()) if line.strip()), "")
    return f"the viewer ended or gave no picture within {timeout_s:g} s: try a longer timeout ({last.strip()})"


def _wait_until_loaded(client: ViewerClient, recording: Path) -> ViewerState:
    while True:
        state = client.get_state()
        if state.recordings and not state.loading and all(r.timelines for r in state.recordings):
            return state
        if any(entry.level == "ERROR" for entry in client.get_logs()):
            raise InputError(f"the viewer cannot read {recording}: it is damaged or was cut short, record it again")
        time.sleep(POLL_S)


def _go_to(client: ViewerClient, state: ViewerState, frame: int | None) -> None:
    timeline = next((t for r in state.recordings for t in r.timelines if t.name == "frame"), None)
    if timeline is None or timeline.start is None or timeline.end is None:
        raise InputError("the recording has no timeline 'frame': give one that was written by this project")
    if frame is None:
        frame = timeline.end
    if not timeline.start <= frame <= timeline.end:
        raise InputError(f"there is no frame {frame}: choose one from {timeline.start} to {timeline.end}")
    client.set_time("frame", sequence=frame, play_state="paused")


def _save_settled(client: ViewerClient, picture: Path) -> None:
    """Images are decoded and views fade in after the first paint, so repeat until two pictures are the same."""
    before = None
    while True:
        client.save_screenshot(str(picture.absolute()))
        now = picture.read_bytes()
        if now == before:
            return
        before = now


def save_overlay(recording: Path, picture: Path, *, frame: int | None = None) -> None:
    """Draw the image and the tracks of a frame with OpenCV, in the colours of the recording.

    Args:
        recording: .rrd file.
        picture: image file to write.
        frame: None is the last one.

    Raises:
        InputError: no such recording, no such frame, or an unwritable picture.
    """
    import cv2

    from viz.overlay import draw_frame
    from viz.recording import Recording

    opened = Recording(recording)
    chosen = opened.at(opened.indices[-1] if frame is None else frame)
    overlay = draw_frame(next(opened.frames(chosen, chosen)))
    try:
        written = cv2.imwrite(str(picture), overlay)
    except cv2.error:  # an ending that OpenCV does not know
        written = False
    if not written:
        raise InputError(f"cannot write {picture}: give a .png or .jpg file in a folder you may write to")


def save_film(recording: Path, film: Path, *, start: int | None = None, end: int | None = None) -> int:
    """Make a film of the image and the tracks, at the recording's frame rate.

    Args:
        recording: .rrd file.
        film: .mp4 file to write.
        start, end: first and last frame; None is the recording's.

    Returns:
        How many frames it has.

    Raises:
        InputError: no such recording, no frame between these, or an unwritable film.
    """
    from viz.film import write_film
    from viz.overlay import draw_frame
    from viz.recording import Recording

    if film.suffix.lower() != ".mp4":
        raise InputError(f"cannot write {film}: films are .mp4 files")
    opened = Recording(recording)
    first, last = opened.indices[0], opened.indices[-1]
    if not any((start or first) <= frame <= (last if end is None else end) for frame in opened.indices):
        raise InputError(f"there is no frame from {start} to {end}: choose frames from {first} to {last}")
    return write_film(film, map(draw_frame, opened.frames(start, end)), opened.fps)


def _take(options: argparse.Namespace) -> list[str]:
    """Do what the flags ask for; returns what the viewer complains about."""
    if options.video is not None:
        save_film(options.recording, options.video, start=options.start, end=options.end)
    if options.picture is None:
        return []
    if options.plain:
        save_overlay(options.recording, options.picture, frame=options.frame)
        return []
    size = (options.size[0], options.size[1])
    return save_picture(options.recording, options.picture, frame=options.frame, size=size, timeout_s=options.timeout)


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
    try:
        complaints = _take(options)
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    for complaint in complaints:
        print(f"the viewer reports: {complaint}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())

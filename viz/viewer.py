"""Starting viewers, in a window or for browsers, and noticing when none comes up."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

PORT = 9876
WEB_PORT = 9090
START_S = 15.0  # a cold start from a slow disk takes several seconds
SETTLE_S = 1.0  # a viewer without a display answers for a moment before it dies

_windows: list[subprocess.Popen[bytes]] = []  # viewers that outlive the run; Python warns of one that nobody holds


def open_viewer(port: int = PORT) -> str | None:
    """The address of a viewer on this machine: the one that listens already, or else a new window.

    Returns:
        `127.0.0.1:PORT`, or None where no window can open.
    """
    address = f"127.0.0.1:{port}"
    if _answers(port):
        return address
    executable = Path(sys.executable).with_name("rerun")
    if not executable.exists():
        return None
    command = [str(executable), "--bind", "127.0.0.1", "--port", str(port), "--expect-data-soon"]
    quiet = subprocess.DEVNULL
    # its own session: Ctrl-C ends the run and leaves the window open
    viewer = subprocess.Popen(
        command, stdin=quiet, stdout=quiet, stderr=quiet, env=environment(), start_new_session=True
    )
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and viewer.poll() is None:
        if _answers(port):
            time.sleep(SETTLE_S)
            if viewer.poll() is not None:
                return None
            _windows.append(viewer)
            return address
        time.sleep(0.05)
    _kill(viewer)
    return None


@dataclass(frozen=True)
class WebViewer:
    """A viewer for browsers of this machine; no other machine can reach it.

    Attributes:
        process: the server.
        url: what to open in a browser.
        stream: where recordings go, and what other viewers can connect to.
    """

    process: subprocess.Popen[bytes]
    url: str
    stream: str

    def close(self) -> None:
        """Stop it."""
        _kill(self.process)


def serve() -> WebViewer | None:
    """Start a viewer for browsers, on the usual ports if they are free; None where it does not start."""
    executable = Path(sys.executable).with_name("rerun")
    if not executable.exists():
        return None
    port, web_port = _free_port(PORT), _free_port(WEB_PORT)
    # Rerun's own `RecordingStream.serve_grpc` would listen to the whole network
    command = [str(executable), "--serve-web", "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--web-viewer-port", str(web_port)]
    quiet = subprocess.DEVNULL
    server = subprocess.Popen(
        command, stdin=quiet, stdout=quiet, stderr=quiet, env=environment(), start_new_session=True
    )
    stream = f"rerun+http://127.0.0.1:{port}/proxy"
    viewer = WebViewer(server, f"http://127.0.0.1:{web_port}/?url={quote(stream, safe='')}", stream)
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and server.poll() is None:
        if _answers(port) and _answers(web_port):
            return viewer
        time.sleep(0.05)
    viewer.close()
    return None


def _kill(viewer: subprocess.Popen[bytes]) -> None:
    """End a viewer that was started in a session of its own."""
    if viewer.poll() is None:
        os.killpg(viewer.pid, signal.SIGKILL)  # `rerun` is a launcher: the viewer is its child
    viewer.wait()


def _free_port(wanted: int) -> int:
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise OSError("no port of this machine is free")


def environment() -> dict[str, str]:
    """The environment to start the viewer in: it reports its use to its makers unless it believes to be in CI."""
    return {**os.environ, "CI": "1"}


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except OSError:
        return False
    return True

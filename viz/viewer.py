"""Starting viewers, in a window or for browsers, and noticing when none comes up."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from urllib.parse import quote

PORT = 9876
WEB_PORT = 9090
START_S = 15.0  # a cold start from a slow disk takes several seconds
SETTLE_S = 1.0  # a viewer without a display answers for a moment before it dies

Viewer = subprocess.Popen[bytes]

_windows: list[Viewer] = []  # viewers that outlive the run; Python warns of one that nobody holds


def start(port: int, *arguments: str, output: int | IO[bytes] = subprocess.DEVNULL, **variables: str) -> Viewer | None:
    """Rerun's program, reachable from this machine alone; None where it is not installed beside this Python.

    It gets a session of its own: Ctrl-C ends the run and leaves a window open.
    """
    program = shutil.which("rerun", path=Path(sys.executable).parent)
    if program is None:
        return None
    return subprocess.Popen(
        [program, "--bind", "127.0.0.1", "--port", str(port), *arguments],
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        env={**os.environ, "CI": "1", **variables},  # it reports its use to its makers unless it believes to be in CI
        start_new_session=True,
    )


def stop(viewer: Viewer) -> None:
    """End a viewer of `start`."""
    if viewer.poll() is None:
        if hasattr(os, "killpg"):
            os.killpg(viewer.pid, signal.SIGKILL)  # `rerun` is a launcher: the viewer is its child
        else:
            viewer.kill()
    viewer.wait()


def open_viewer(port: int = PORT) -> str | None:
    """`127.0.0.1:PORT` of the viewer that listens there already, or else of a new window; None where none can open."""
    address = f"127.0.0.1:{port}"
    if _answers(port):
        return address
    viewer = start(port, "--expect-data-soon")
    if viewer is None or not _comes_up(viewer, port):
        return None
    time.sleep(SETTLE_S)
    if viewer.poll() is not None:
        return None
    _windows.append(viewer)
    return address


@dataclass(frozen=True)
class WebViewer:
    """A viewer for browsers of this machine; no other machine can reach it.

    Attributes:
        process: the server.
        url: what to open in a browser.
        stream: where recordings go, and what other viewers can connect to.
    """

    process: Viewer
    url: str
    stream: str

    def close(self) -> None:
        """Stop it."""
        stop(self.process)


def serve() -> WebViewer | None:
    """Start a viewer for browsers, on the usual ports if they are free; None where it does not start."""
    port, web_port = free_port(PORT), free_port(WEB_PORT)
    # Rerun's own `RecordingStream.serve_grpc` would listen to the whole network
    server = start(port, "--serve-web", "--web-viewer-port", str(web_port))
    if server is None or not _comes_up(server, port, web_port):
        return None
    stream = f"rerun+http://127.0.0.1:{port}/proxy"
    return WebViewer(server, f"http://127.0.0.1:{web_port}/?url={quote(stream, safe='')}", stream)


def free_port(wanted: int = 0) -> int:
    """A port of this machine that no other program has: the wanted one if possible."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise OSError("no port of this machine is free")


def _comes_up(viewer: Viewer, *ports: int) -> bool:
    """Whether a viewer answers at all these ports before it ends or takes too long; if not, it is stopped."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and viewer.poll() is None:
        if all(_answers(port) for port in ports):
            return True
        time.sleep(0.05)
    stop(viewer)
    return False


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except OSError:
        return False
    return True

"""Opening a viewer window, and noticing when none comes up."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

PORT = 9876
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
    viewer.kill()
    viewer.wait()
    return None


def environment() -> dict[str, str]:
    """The environment to start the viewer in: it reports its use to its makers unless it believes to be in CI."""
    return {**os.environ, "CI": "1"}


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except OSError:
        return False
    return True

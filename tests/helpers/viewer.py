"""Rerun's viewer: whether this machine can draw it, which ones run, one that saves, and pictures of one."""

from __future__ import annotations

import ctypes.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.helpers.ports import listening
from viz.viewer import environment

ROOT = Path(__file__).parents[2]
RERUN = Path(sys.executable).parent / "rerun"


def have_vulkan() -> bool:
    """Whether a Vulkan loader and at least one driver are installed."""
    folders = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"), Path("/usr/local/share/vulkan/icd.d"))
    return ctypes.util.find_library("vulkan") is not None and any(any(f.glob("*.json")) for f in folders)


needs_viewer = pytest.mark.skipif(
    not have_vulkan() or not RERUN.exists(),
    reason="needs the Rerun viewer and a Vulkan driver (Debian: mesa-vulkan-drivers libvulkan1)",
)


def snapshot(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """`python -m viz.snapshot` with these arguments."""
    return subprocess.run(
        [sys.executable, "-m", "viz.snapshot", *map(str, arguments)],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=90,
    )


def viewers(port: int) -> list[int]:
    """Process ids of viewers at a port."""
    needle = f"--port\0{port}\0".encode()
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if needle in (folder / "cmdline").read_bytes() + b"\0":
                found.append(int(folder.name))
        except OSError:  # it ended meanwhile
            continue
    return found


@contextmanager
def saving_viewer(port: int, path: Path) -> Iterator[None]:
    """The viewer, which writes all that it receives within the block into a file instead of showing it."""
    quiet = subprocess.DEVNULL
    command = [RERUN, "--bind", "127.0.0.1", "--port", str(port), "--save", str(path)]
    viewer = subprocess.Popen(
        command, env=environment(), stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
    )
    try:
        deadline = time.monotonic() + 30
        while not listening(port):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        yield
        size = -1
        while size != (size := path.stat().st_size):  # it writes in its own time
            time.sleep(1)
    finally:
        os.killpg(viewer.pid, signal.SIGKILL)  # `rerun` is a launcher: the viewer is its child
        viewer.wait()

"""Recordings to test with, and Rerun's viewer: whether this machine can draw it, which ones run, one that saves."""

from __future__ import annotations

import ctypes.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from frontend.protocols import FrameResult
from tests.helpers.command import ROOT, recorded
from tests.helpers.moving_rectangle import frame_results
from tests.helpers.ports import listening
from viz.rerun_sink import RerunSink
from viz.viewer import start, stop

FRAMES = 10
TRACKS = "Tracks (bold: long and old, thin: other confirmed ones, tails: where they were)"
RERUN = Path(sys.executable).parent / "rerun"


def have_vulkan() -> bool:
    """Whether a Vulkan loader and at least one driver are installed."""
    folders = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"), Path("/usr/local/share/vulkan/icd.d"))
    return ctypes.util.find_library("vulkan") is not None and any(any(f.glob("*.json")) for f in folders)


needs_viewer = pytest.mark.skipif(
    not have_vulkan() or not RERUN.exists(),
    reason="needs the Rerun viewer and a Vulkan driver (Debian: mesa-vulkan-drivers libvulkan1)",
)


def record(path: Path, results: Iterable[FrameResult] | None = None, **options: Any) -> dict[str, dict[str, list[Any]]]:
    """What the sink makes of results, or of `FRAMES` of the moving rectangle, read back."""
    with closing(RerunSink(save=path, **options)) as sink:
        for result in results or frame_results(FRAMES):
            sink.write(result)
        sink.close()
    return recorded(path)


def contents_of_views(path: Path) -> dict[str, set[str]]:
    """What the views in a recording's layouts show, by their titles."""
    from rerun.chunk import RrdReader

    found: dict[str, dict[str, list[str]]] = {"ViewBlueprint:display_name": {}, "ViewContents:query": {}}
    for blueprint in RrdReader(path).blueprints():
        for chunk in RrdReader(path).stream(store=blueprint).to_chunks():
            batch = chunk.to_record_batch()
            for column, values in found.items():
                if column in batch.schema.names:
                    values[chunk.entity_path.removesuffix("/ViewContents")] = batch.column(column).to_pylist()[-1]
    names, contents = found.values()
    return {name: set(contents[view]) for view, (name,) in names.items()}


def names_of_views(path: Path) -> set[str]:
    """The titles in a recording's layouts."""
    return set(contents_of_views(path))


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
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it ended meanwhile
            if f"--port\0{port}\0".encode() in (folder / "cmdline").read_bytes() + b"\0":
                found.append(int(folder.name))
    return found


@contextmanager
def serving(port: int, *arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    """Rerun's program, which listens at a port until the end of the block."""
    viewer = start(port, *map(str, arguments))
    assert viewer is not None
    try:
        deadline = time.monotonic() + 30
        while not listening(port):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        yield viewer
    finally:
        if viewer.poll() is None:
            os.killpg(viewer.pid, signal.SIGCONT)
        stop(viewer)


@contextmanager
def saving_viewer(port: int, path: Path) -> Iterator[None]:
    """The viewer, which writes all that it receives within the block into a file instead of showing it."""
    with serving(port, "--save", path):
        yield
        size = -1
        while size != (size := path.stat().st_size):  # it writes in its own time
            time.sleep(1)

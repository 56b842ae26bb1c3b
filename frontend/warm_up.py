"""Everything compiled and loaded before the first frame.

On a machine's first start the compiler takes most of the time. It does one thing at a time within a process, so another
process compiles about half of it into the cache, the last steps of the detector and the tracker, while the rest is
compiled here; or all of it, while the renderer of the built-in clip is compiled here.
"""

from __future__ import annotations

import atexit
import gc
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airline.detector import AirLine
from airline.kernels.threads import cores
from airline.lines import LineSet
from airline.warm_up import compile_last_steps
from frontend.frame import Frame
from frontend.tracker import LineTracker
from frontend.tracking.config import TrackerConfig
from frontend.tracking.overlap import _votes

SIZE = 64, 80  # rows and columns of the image with which the other process compiles

_helper: subprocess.Popen[bytes] | None = None


def compile_ahead() -> None:
    """On the first start, have all compiled by another process, long before `warm_up` needs it."""
    global _helper
    _helper = _start_helper("all") if _helper is None else _helper


def warm_up(detector: AirLine, config: TrackerConfig, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """A throw-away pass through a detector and a tracker.

    Args:
        detector: it keeps what it loads.
        config: the tracker's settings.
        image: an image like those to come.
    """
    with _few_collections(), _using_helper() as wait:
        lines = detector(image)
        wait()
        _track(config, image, lines)


@contextmanager
def _using_helper() -> Iterator[Callable[[], object]]:
    """A call that waits for the other process's half; what it has not compiled by then is compiled here."""
    global _helper
    helper, _helper = _helper or _start_helper("half"), None
    if helper is None or helper.stdout is None:
        yield lambda: None
        return
    with helper:  # which closes the pipe and waits for the process
        try:
            yield helper.stdout.readline
        finally:
            helper.kill()


@contextmanager
def _few_collections() -> Iterator[None]:
    """Spare Python's garbage collector the compiler's many objects: looking through all of them takes a second."""
    usual = gc.get_threshold()
    gc.set_threshold(*usual[:2], 1000)
    try:
        yield
    finally:
        gc.set_threshold(*usual)


def _track(config: TrackerConfig, image: NDArray[np.uint8] | NDArray[np.uint16], lines: LineSet) -> None:
    tracker = LineTracker(config)
    for index in range(2):
        tracker.update(Frame(index, index, image), lines)


def _is_cold() -> bool:
    """Whether there is a cache of compiled code, and none of the tracker's in it."""
    folder = _votes.stats.cache_path
    return folder is not None and not any(Path(folder).glob("overlap._votes-*.nbi"))


def _start_helper(share: str) -> subprocess.Popen[bytes] | None:
    """The process that compiles, where there is something to compile and a core for it."""
    if cores() == 1 or not _is_cold():
        return None
    command = [sys.executable, "-m", "frontend.warm_up", share]
    try:
        helper = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    except OSError:  # no more processes, or no Python by that name
        return None
    atexit.register(helper.kill)
    return helper


def _made_up() -> tuple[NDArray[np.uint8], LineSet]:
    """A picture and lines in it, of the kinds of array that the detector answers."""
    rows, columns = SIZE
    image = np.zeros(SIZE, np.uint8)
    image[:, columns // 2 :] = 200
    places = np.linspace(8, columns - 8, 12, dtype=np.float32)
    segments = np.stack([np.stack([places, np.full_like(places, end)], axis=1) for end in (4, rows - 4)], axis=1)
    ones = np.ones(len(segments), np.float32)
    return image, LineSet(
        np.ascontiguousarray(segments), ones, np.tile(ones[:, None] / np.sqrt(np.float32(6)), 6), ones
    )


if __name__ == "__main__":
    with _few_collections():
        compile_last_steps()
        image, lines = _made_up()
        _track(TrackerConfig(), image, lines)
        print("half", flush=True)
        if sys.argv[1:] == ["all"]:
            AirLine()(image)

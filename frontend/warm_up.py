"""Everything compiled and loaded before the first frame.

On a machine's first start the compiler takes most of the time. It does one thing at a time within a process, so another
process compiles into the cache, too: first the last steps of the detector and the tracker, then all the rest.
"""

from __future__ import annotations

import atexit
import gc
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airline.detector import AirLine
from airline.kernels.threads import cores
from airline.lines import LineSet
from airline.stages.fit import TotalLeastSquaresFitter
from airline.stages.refine import ImageRefiner
from airline.trace import Trace
from frontend.frame import Frame
from frontend.tracker import LineTracker
from frontend.tracking.camera_motion import LEAST_POINTS, Motion, camera_motion
from frontend.tracking.config import TrackerConfig
from frontend.tracking.overlap import _votes

_helper: subprocess.Popen[bytes] | None = None


def compile_ahead() -> bool:
    """On a machine's first start, begin to compile in another process, long before `warm_up` needs it.

    Returns whether there is something to compile, which makes this start some 10 s longer.
    """
    global _helper
    folder = _votes.stats.cache_path
    is_cold = folder is not None and not any(Path(folder).glob("overlap._votes-*.nbi"))
    if _helper is None and is_cold and cores() > 1:
        with suppress(OSError):  # no more processes, or no Python by that name
            _helper = subprocess.Popen(
                [sys.executable, "-m", "frontend.warm_up"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
            atexit.register(_helper.kill)
    return is_cold


def warm_up(
    detector: AirLine, config: TrackerConfig, image: NDArray[np.uint8] | NDArray[np.uint16], *, stereo: bool = False
) -> None:
    """A throw-away pass of such an image, or pair, through a detector, which keeps what it loads, and a tracker."""
    global _helper
    compile_ahead()
    with _few_collections():
        trace = detector.trace(image)
        if _helper is not None and _helper.stdout is not None:
            _helper.stdout.readline()  # its half is done, or it has ended: then the rest is compiled here
            _helper.kill()
            _helper.communicate()
            _helper = None
        _track(config, image, trace.lines, trace if stereo else None)


@contextmanager
def _few_collections() -> Iterator[None]:
    """Spare Python's garbage collector the compiler's many objects: looking through all of them takes a second."""
    usual = gc.get_threshold()
    gc.set_threshold(*usual[:2], 1000)
    try:
        yield
    finally:
        gc.set_threshold(*usual)


def _track(
    config: TrackerConfig, image: NDArray[np.uint8] | NDArray[np.uint16], lines: LineSet, right: Trace | None = None
) -> None:
    tracker, edges = LineTracker(config), np.zeros(image.shape[:2], np.float32)
    for index in range(2):
        tracker.update(Frame(index, index, image, right=None if right is None else image), lines, edges, right)
    points, ones = np.zeros((LEAST_POINTS, 2), np.float32), np.ones(LEAST_POINTS, np.float32)
    camera_motion(points, points, ones, ones, 1.0, Motion())  # even if nothing flows in this image


def _compile_all() -> None:
    """What the other process does, on a picture and lines in it of the kinds of array that the detector answers."""
    _compile_last_steps()
    image = np.zeros((64, 80), np.uint8)
    image[:, 40:] = 200
    segments = np.array([[[x, 4], [x, 60]] for x in np.linspace(8, 72, 12)], np.float32)
    ones = np.ones(len(segments), np.float32)
    descriptors = np.full((len(segments), 6), 1 / np.sqrt(np.float32(6)), np.float32)
    _track(TrackerConfig(), image, LineSet(segments, ones, descriptors, ones))
    print("half", flush=True)
    AirLine()(image)


def _compile_last_steps() -> None:
    """The line fit's second half, on one made-up part, and the refinement."""
    count = 12
    x, y = np.arange(count) + 3.0, np.full(count, 4.0)
    sums = [np.sum(values) for values in (np.ones(count), x, y, x * x, x * y, y * y)]
    moments = np.array([[*sums, x[0], y[0], x[-1], y[-1]]])
    support, descriptors = np.ones((24, 24), np.float32), np.eye(6, dtype=np.float32)[np.zeros(count, int)]
    rows, bounds, merged = np.arange(count), np.array([[0, count]]), np.zeros(1, np.int64)
    lines, _ = TotalLeastSquaresFitter().choose(support, descriptors, (rows, bounds, moments), merged)
    assert len(lines) == 1
    ImageRefiner().refine(lines, support.astype(np.uint8))


if __name__ == "__main__":
    with _few_collections():
        _compile_all()

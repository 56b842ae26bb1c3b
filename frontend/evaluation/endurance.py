"""What a long run must not do: grow, slow down, lose or repeat a frame, use a track id twice."""

from __future__ import annotations

import gc
import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frontend.protocols import FrameResult
from frontend.tracks import LineTracks

_BLOCKS = 20  # samples follow each other too closely to count each; medians of so many blocks do not
_T_95 = 2.101  # Student's t for 18 degrees of freedom, two-sided


@dataclass(frozen=True)
class Trend:
    """How a figure changes along a run.

    Attributes:
        mean: of all samples.
        noise: standard deviation of the samples about the trend.
        change: by how much the trend's line rises from the first to the last sample.
        margin: half the width of its 95 % confidence interval.
    """

    mean: float
    noise: float
    change: float
    margin: float

    @property
    def least(self) -> float:
        """The change that is certain: 0 where the interval holds 0."""
        return max(0.0, self.change - self.margin)


def trend(values: NDArray[np.float64]) -> Trend:
    """The line through equally spaced samples, its confidence by the scatter of block medians.

    Args:
        values: (N,) samples, N of 20 or more.
    """
    place = np.linspace(-0.5, 0.5, len(values))
    blocks = np.array([[np.median(part) for part in np.array_split(v, _BLOCKS)] for v in (place, values)])
    x, y = blocks[0] - blocks[0].mean(), blocks[1] - blocks[1].mean()
    slope = float(x @ y / (x @ x))
    error = float(np.sqrt(((y - slope * x) ** 2).sum() / (_BLOCKS - 2) / (x @ x)))
    noise = float(np.std(values - values.mean() - slope * (place - place.mean())))
    return Trend(float(values.mean()), noise, slope, _T_95 * error)


class Endurance:
    """Watches every frame of a run, in constant memory but for the samples; a `Sink`.

    Args:
        first_index: number of the first frame.
        every: frames per sample.

    Attributes:
        faults: what must not happen and did, one sentence each; at most twenty are kept.
        frames: so far.
        tracks: ids so far.
        memory_mb: resident memory at every sample.
        cpu_ms: processor time per frame of this process, all threads, over every sample.
        handles: open files and threads at every sample.
    """

    def __init__(self, every: int, first_index: int = 0) -> None:
        self.faults: list[str] = []
        self.frames = 0
        self.tracks = 0
        self.memory_mb: list[float] = []
        self.cpu_ms: list[float] = []
        self.handles: list[int] = []
        self._every = every
        self._next_index = first_index
        self._last_ns: int | None = None
        self._highest = -1
        self._alive: set[int] = set()
        self._cpu_s = time.process_time()

    def write(self, result: FrameResult) -> None:
        """Check one frame, and take a sample when it is time."""
        tracks = result.tracks
        self._check_order(tracks)
        self._check_ids(tracks)
        self.frames += 1
        if self.frames % self._every == 0:
            self._sample()

    def close(self) -> None:
        """Nothing is open."""

    def _check_order(self, tracks: LineTracks) -> None:
        if tracks.frame_index != self._next_index:
            self._fault(f"frame {tracks.frame_index} came where frame {self._next_index} was due")
        if self._last_ns is not None and tracks.stamp_ns <= self._last_ns:
            self._fault(f"the time of frame {tracks.frame_index} is not later than that of the one before")
        self._next_index, self._last_ns = tracks.frame_index + 1, tracks.stamp_ns

    def _check_ids(self, tracks: LineTracks) -> None:
        """New ids are higher than all before; others are alive; what has ended does not come back."""
        ids = tracks.ids.tolist()
        seen = set(ids)
        if len(seen) != len(ids):
            self._fault(f"frame {tracks.frame_index} has a track id twice")
        if tracks.reset is not None:
            self._alive.clear()
        old = {track for track in seen if track <= self._highest}
        if not old <= self._alive:
            self._fault(f"frame {tracks.frame_index} uses track id {min(old - self._alive)} again")
        self.tracks += len(seen) - len(old)
        self._highest = max(self._highest, *seen) if seen else self._highest
        self._alive |= seen
        self._alive -= set(tracks.ended_ids.tolist())

    def _sample(self) -> None:
        now_s = time.process_time()
        self.cpu_ms.append(1e3 * (now_s - self._cpu_s) / self._every)
        self.memory_mb.append(resident_mb())
        self.handles.append(open_files() + threading.active_count())
        self._cpu_s = time.process_time()

    def _fault(self, text: str) -> None:
        if len(self.faults) < 20:
            self.faults.append(text)


def resident_mb() -> float:
    """Memory of this process in MB, garbage collected first; NaN where the system does not say."""
    gc.collect()
    sizes = Path("/proc/self/statm")
    if not sizes.exists():
        return float("nan")
    return int(sizes.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def open_files() -> int:
    """How many files this process has open; 0 where the system does not say."""
    listing = Path("/proc/self/fd")
    return len(list(listing.iterdir())) if listing.exists() else 0

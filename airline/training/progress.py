"""What a training shows: a progress bar on a terminal, a log line every so often elsewhere."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

log = logging.getLogger("airline.train")

Item = TypeVar("Item")
Result = TypeVar("Result")
LOG_EVERY = 30.0  # s
SHOW_EVERY = 0.2  # s


def in_parallel(work: Callable[[Item], Result], items: Sequence[Item], title: str) -> list[Result]:
    """Results in the order of the items, made by threads, with a passing progress bar on stderr if that is a terminal.

    Threads and no processes: the work is done in OpenCV and compiled code, and a forked OpenCV can hang.
    """
    console = Console(stderr=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results = pool.map(work, items)
        if not console.is_terminal:
            return list(results)
        with Progress(console=console, transient=True) as bar:
            return list(bar.track(results, total=len(items), description=title))


class TrainingProgress:
    """Speed, loss and latest score of a running training."""

    def __init__(self, bar: Progress, steps: int | None, first: int) -> None:
        """Count from step `first` to `steps`, where that is known."""
        self.score = ""  # the latest, as text
        self._bar, self._total, self._steps, self._loss = bar, f"/{steps}" if steps else "", 0, 0.0
        self._task = bar.add_task(f"step {first}{self._total}", total=1.0)
        self._started = self._shown = self._logged = time.monotonic()

    def update(self, step: int, done: float, loss: float) -> None:
        """Take note of a finished step.

        Args:
            step: number of steps behind us, also those of earlier runs.
            done: share of the training behind us.
            loss: of this step.
        """
        self._steps += 1
        self._loss += max(0.02, 1 / self._steps) * (loss - self._loss)
        now = time.monotonic()
        if now - self._shown < SHOW_EVERY and done < 1:
            return
        self._shown = now
        speed = self._steps / max(now - self._started, 1e-6)
        text = f"step {step}{self._total}  {speed:.1f} steps/s  loss {self._loss:.4f}  {self.score}".rstrip()
        if not self._bar.disable:
            self._bar.update(self._task, completed=min(done, 1.0), description=text)
        elif now - self._logged >= LOG_EVERY or done >= 1:
            self._logged = now
            log.info("%s", text)


@contextmanager
def training_progress(steps: int | None, first: int) -> Iterator[TrainingProgress]:
    """The progress of a training, shown on stderr while the context lasts."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        yield TrainingProgress(bar, steps, first)

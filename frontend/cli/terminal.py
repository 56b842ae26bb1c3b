"""What a run shows in the terminal: a progress bar, and log lines above it."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from airline.command import StderrHandler


@contextmanager
def progress(name: str, total: int | None, unit: str = "frames") -> Iterator[Callable[..., None]]:
    """A progress bar with frames/s on stderr; none where that is no terminal. Yields what to call per frame.

    It may be called with words that are shown beside the bar.

    Args:
        name: shown before the bar.
        total: number of frames to come, or None where nobody knows.
        unit: what is counted, where that is not frames.
    """
    if not sys.stderr.isatty():
        yield lambda words="": None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text(f"{speed:.1f} {unit}/s" if speed else "")

    title = TextColumn("{task.description}", markup=False)  # a file name may hold brackets
    more = TextColumn("{task.fields[words]}", markup=False)
    columns = (title, BarColumn(), MofNCompleteColumn(), Rate(), more, TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(name, total=total, words="")
        yield lambda words="": bar.update(task, advance=1, words=words)


def set_up_logging(verbosity: int) -> None:
    """Warnings of everybody, and of our own packages as much as is asked for."""
    logging.basicConfig(format="%(levelname)s: %(message)s", handlers=[StderrHandler()])
    # to it a viewer that leaves is an error
    logging.getLogger("foxglove.websocket.connected_client").setLevel(logging.CRITICAL)
    for package in ("airline", "frontend", "logs", "viz"):
        logging.getLogger(package).setLevel([logging.WARNING, logging.INFO, logging.DEBUG][min(verbosity, 2)])

"""A training run as a user sees it: progress, scores and pictures every so often, checkpoints, Ctrl-C."""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from airline.training import checkpoint
from airline.training.crops import Crops
from airline.training.loop import Schedule, State, train
from airline.training.validation import Validation

log = logging.getLogger("airline.train")

LOG_EVERY = 30.0  # s, where no terminal shows a bar
SHOW_EVERY = 0.2  # s


@dataclass(frozen=True)
class Session:
    """What surrounds the training loop.

    Attributes:
        schedule: how long, and how fast.
        validation: what to measure at the end, and also
        validate_every: so many seconds; each time a checkpoint is kept.
        settings: what a checkpoint must agree with.
        checkpoint: its file.
        sheets: folder for pictures of held-out samples.
    """

    schedule: Schedule
    validation: Validation
    validate_every: float
    settings: checkpoint.Settings
    checkpoint: Path
    sheets: Path

    def run(self, state: State, crops: Crops) -> bool:
        """Train to the end, from the checkpoint if there is one; False if Ctrl-C stopped it before.

        Raises:
            AirLineError: the checkpoint does not fit, a file cannot be written, or the loss is not finite any more.
        """
        checkpoint.restore(state, self.settings, self.checkpoint)
        with _Progress(self.schedule.steps, state.step) as progress, first_interrupt() as asked:
            validated = time.monotonic()

            def after_step(loss: float) -> bool:
                nonlocal validated
                done = self.schedule.done(state.step, state.seconds)
                progress.show(state.step, done, loss)
                if time.monotonic() - validated >= self.validate_every and done < 1:
                    progress.score = self._validate(state)
                    checkpoint.save(state, self.settings, False, self.checkpoint)
                    validated = time.monotonic()
                return asked.is_set()

            train(state, crops, self.schedule, after_step)
            finished = self.schedule.done(state.step, state.seconds) >= 1
            if finished:
                self._validate(state)
            checkpoint.save(state, self.settings, finished, self.checkpoint)
        if not finished:
            log.info("stopped at step %d: the same command goes on from %s", state.step, self.checkpoint)
        return finished

    def _validate(self, state: State) -> str:
        scores = self.validation.measure(state.net, state.device)
        latest = scores["photographs"].f2
        if latest >= state.best:
            state.best, state.best_step = latest, state.step
        for kind, score in scores.items():
            log.info("step %d  held-out %s: %s", state.step, kind, score)
        log.info("step %d  best F on photographs: %.1f at step %d", state.step, state.best, state.best_step)
        self.sheets.mkdir(exist_ok=True)
        self.validation.write_sheet(state.net, state.device, self.sheets / f"step-{state.step:06d}.png")
        return f"F {latest:.1f}"


class _Progress:
    """Speed, loss and latest score: a bar on stderr if that is a terminal, else a log line every so often."""

    def __init__(self, steps: int | None, first: int) -> None:
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
        self.score = ""
        self._bar = Progress(*columns, console=console, disable=not console.is_terminal)
        self._total, self._steps, self._loss = f"/{steps}" if steps else "", 0, 0.0
        self._task = self._bar.add_task(f"step {first}{self._total}", total=1.0)
        self._started = self._shown = self._logged = time.monotonic()

    def __enter__(self) -> _Progress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def show(self, step: int, done: float, loss: float) -> None:
        """Take note of a finished step, of a share of the training that is behind us, and of its loss."""
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
def first_interrupt() -> Iterator[threading.Event]:
    """The first Ctrl-C sets the event and nothing else, so that no step is torn; the second one interrupts."""
    asked = threading.Event()

    def on_interrupt(number: int, frame: object) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()

    before = signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)

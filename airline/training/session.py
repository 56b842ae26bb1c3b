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

from airline.training import checkpoint
from airline.training.dataset import Sample
from airline.training.loop import State, train
from airline.training.loss import PixelWeights
from airline.training.progress import TrainingProgress, training_progress
from airline.training.schedule import Schedule
from airline.training.validation import Validation

log = logging.getLogger("airline.train")


@dataclass(frozen=True)
class Session:
    """What surrounds the training loop.

    Attributes:
        schedule: how long, and how fast.
        validation: what to measure, not only at the end but
        validate_every: so many seconds, too; each time a checkpoint is kept.
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

    def run(self, state: State, samples: list[Sample], seed: int, weigh: PixelWeights) -> bool:
        """Train to the end, from the checkpoint if there is one; False if Ctrl-C stopped it before.

        Raises:
            AirLineError: the checkpoint does not fit, a file cannot be written, or the loss is not finite any more.
        """
        checkpoint.restore(state, self.settings, self.checkpoint)
        with training_progress(self.schedule.steps, state.step) as progress, first_interrupt() as asked:
            validated = time.monotonic()

            def after_step(loss: float) -> bool:
                nonlocal validated
                progress.update(state.step, self._done(state), loss)
                if time.monotonic() - validated >= self.validate_every and self._done(state) < 1:
                    self._validate(state, progress)
                    checkpoint.save(state, self.settings, False, self.checkpoint)
                    validated = time.monotonic()
                return asked.is_set()

            train(state, samples, self.schedule, seed, weigh, after_step)
            finished = self._done(state) >= 1
            if finished:
                self._validate(state, progress)
            checkpoint.save(state, self.settings, finished, self.checkpoint)
        if not finished:
            log.info("stopped at step %d: the same command goes on from %s", state.step, self.checkpoint)
        return finished

    def _done(self, state: State) -> float:
        return self.schedule.done(state.step, state.seconds)

    def _validate(self, state: State, progress: TrainingProgress) -> None:
        scores = self.validation.measure(state.net, state.device)
        latest = scores["photographs"].f2
        if latest >= state.best:
            state.best, state.best_step = latest, state.step
        progress.score = f"F {latest:.1f}"
        for kind, score in scores.items():
            log.info("step %d  held-out %s: %s", state.step, kind, score)
        log.info("step %d  best F on photographs: %.1f at step %d", state.step, state.best, state.best_step)
        self.sheets.mkdir(exist_ok=True)
        self.validation.write_sheet(state.net, state.device, self.sheets / f"step-{state.step:06d}.png")


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

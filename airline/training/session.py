"""A training run as a user sees it: progress, scores and pictures every so often, checkpoints, Ctrl-C."""

from __future__ import annotations

import logging
import pickle
import signal
import threading
import time
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from airline.errors import InputError
from airline.training.crops import Crops
from airline.training.loop import Schedule, State, Validation, train

log = logging.getLogger("airline.train")

Settings = Mapping[str, str | int | float | None]  # by the name of the option
LENGTHS = ("--steps", "--minutes")
LOG_EVERY = 30.0  # s, where no terminal shows a bar
COUNTERS = ("step", "seconds", "best", "best_step")  # of the state
DAMAGE = (OSError, EOFError, LookupError, RuntimeError, TypeError, ValueError, pickle.UnpicklingError,
          zipfile.BadZipFile, zlib.error)  # fmt: skip


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
    settings: Settings
    checkpoint: Path
    sheets: Path

    def run(self, state: State, crops: Crops) -> bool:
        """Train to the end, from the checkpoint if there is one; False if Ctrl-C stopped it; raises AirLineError."""
        restore(state, self.settings, self.checkpoint)
        console, steps = Console(stderr=True), f"/{self.schedule.steps}" if self.schedule.steps else ""
        columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn()
        first, smoothed, score = state.step, 0.0, ""
        with Progress(*columns, console=console, disable=not console.is_terminal) as bar, first_interrupt() as asked:
            task = bar.add_task(f"step {first}{steps}", total=1.0)
            started = validated = logged = time.monotonic()

            def after_step(loss: float) -> bool:
                nonlocal smoothed, score, validated, logged
                done, now, count = self.schedule.done(state.step, state.seconds), time.monotonic(), state.step - first
                smoothed += max(0.02, 1 / count) * (loss - smoothed)
                speed = count / max(now - started, 1e-6)
                text = f"step {state.step}{steps}  {speed:.1f} steps/s  loss {smoothed:.4f}  {score}".rstrip()
                bar.update(task, completed=min(done, 1.0), description=text)
                if bar.disable and (now - logged >= LOG_EVERY or done >= 1):
                    logged = now
                    log.info("%s", text)
                if now - validated >= self.validate_every and done < 1:
                    score = self._validate(state)
                    save(state, self.settings, False, self.checkpoint)
                    validated = time.monotonic()
                return asked.is_set()

            train(state, crops, self.schedule, after_step)
            finished = self.schedule.done(state.step, state.seconds) >= 1
            if finished:
                self._validate(state)
            save(state, self.settings, finished, self.checkpoint)
        if not finished:
            log.info("stopped at step %d: the same command goes on from %s", state.step, self.checkpoint)
        return finished

    def _validate(self, state: State) -> str:
        """Log the scores and write a picture; the score for the progress bar."""
        scores = self.validation.measure(state.net, state.device)
        first = next(iter(scores))
        latest = scores[first][1].f2
        if latest >= state.best:
            state.best, state.best_step = latest, state.step
        for kind, (loss, lines) in scores.items():
            figures = loss, lines.f2, lines.p2, lines.r2
            log.info("step %d  held-out %s: loss %.4f, F %.1f (P %.1f, R %.1f)", state.step, kind, *figures)
        log.info("step %d  best F on %s: %.1f at step %d", state.step, first, state.best, state.best_step)
        self.sheets.mkdir(exist_ok=True)
        self.validation.write_sheet(state.net, state.device, self.sheets / f"step-{state.step:06d}.png")
        return f"F {latest:.1f}"


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


def save(state: State, settings: Settings, finished: bool, path: Path) -> None:
    """Write a checkpoint, complete or not at all; InputError where that fails."""
    content = {
        "settings": dict(settings),
        "finished": finished,
        "net": state.net.state_dict(),
        "optimiser": state.optimiser.state_dict(),
        **{name: getattr(state, name) for name in COUNTERS},
    }
    partial = path.with_name(path.name + ".partial")
    try:
        torch.save(content, partial)
        partial.replace(path)
    except (OSError, RuntimeError) as error:
        raise InputError(f"cannot write {path} ({_short(error)}): make room, or give an --out elsewhere") from None


def restore(state: State, settings: Settings, path: Path) -> None:
    """Bring a fresh state to where the checkpoint, if any, stands; InputError if it is damaged or does not fit."""
    if not path.exists():
        return
    try:
        with zipfile.ZipFile(path) as archive:  # torch itself does not look at the checksums
            if archive.testzip() is not None:
                raise ValueError("wrong checksum")
        content = torch.load(path, map_location="cpu", weights_only=True)
        if not isinstance(content, dict):
            raise TypeError(f"it holds a {type(content).__name__}")
    except DAMAGE as error:
        raise InputError(f"the checkpoint {path} is damaged ({_short(error)}): delete it to start again") from None
    try:
        _check(content["settings"], settings, content["finished"], path)
        state.net.load_state_dict(content["net"])
        state.optimiser.load_state_dict(content["optimiser"])
        for name in COUNTERS:
            setattr(state, name, content[name])
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        reason = f"is no checkpoint of this training ({_short(error)})"
        raise InputError(f"{path} {reason}: delete it to start again") from None
    log.info("going on at step %d from %s", state.step, path)


def _check(stored: Settings, settings: Settings, finished: bool, path: Path) -> None:
    changed = {key: (stored.get(key), settings[key]) for key in settings if stored.get(key) != settings[key]}
    for key, (before, now) in changed.items():
        if len(changed) == 1 and key in LENGTHS and finished and float(now or 0) > float(before or 0):
            log.info("the finished training is extended from %s %s to %s, on the schedule of the new length",
                     key, before, now)  # fmt: skip
            return
    if changed:
        differences = ", ".join(f"{key} was {before} and is {now}" for key, (before, now) in changed.items())
        advice = "repeat them to go on, or delete the file to start again"
        raise InputError(f"{path} was made with other settings ({differences}): {advice}")


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:160]

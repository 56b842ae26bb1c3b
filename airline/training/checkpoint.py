"""Checkpoints: everything that a stopped training needs to go on as if nothing had happened."""

from __future__ import annotations

import logging
import pickle
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from airline.errors import InputError
from airline.training.loop import State

log = logging.getLogger("airline.train")

Settings = Mapping[str, str | int | float | None]  # by the name of the option
LENGTHS = ("--steps", "--minutes")
COUNTERS = ("step", "seconds", "best", "best_step")  # of the state
DAMAGE = (OSError, EOFError, LookupError, RuntimeError, TypeError, ValueError, pickle.UnpicklingError,
          zipfile.BadZipFile, zlib.error)  # fmt: skip


def save(state: State, settings: Settings, finished: bool, path: Path) -> None:
    """Write a checkpoint; an older one is replaced only when the new one is complete.

    Raises:
        InputError: it cannot be written.
    """
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
    """Bring a fresh state to where the checkpoint stands; nothing happens where there is none.

    Raises:
        InputError: the file is damaged, or made with settings under which this training cannot go on from it.
    """
    if not path.exists():
        return
    content = _read(path)
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


def _read(path: Path) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(path) as archive:  # torch itself does not look at the checksums
            if archive.testzip() is not None:
                raise ValueError("wrong checksum")
        content = torch.load(path, map_location="cpu", weights_only=True)
        if not isinstance(content, dict):
            raise TypeError(f"it holds a {type(content).__name__}")
    except DAMAGE as error:
        raise InputError(f"the checkpoint {path} is damaged ({_short(error)}): delete it to start again") from None
    return content


def _check(stored: Settings, settings: Settings, finished: bool, path: Path) -> None:
    changed = {key: (stored[key], settings[key]) for key in settings if stored[key] != settings[key]}
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

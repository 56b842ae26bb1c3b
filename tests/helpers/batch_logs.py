"""Recordings for batches, and what batches leave."""

from __future__ import annotations

import time
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from tests.helpers.camera_logs import EPOCH_NS, STEP_NS, Channel, Logged, write_log
from tests.helpers.camera_messages import cdr


def camera_log(path: Path, clip: Path) -> Path:
    """A log of the clip's pictures."""
    messages = []
    for number, picture in enumerate(sorted(clip.iterdir())):
        stamp_ns = EPOCH_NS + number * STEP_NS
        data = cdr("CompressedImage", stamp_ns=stamp_ns, format="png", data=np.fromfile(picture, np.uint8))
        messages.append(Logged(stamp_ns, data))
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_log(path, {"/camera": Channel("sensor_msgs/msg/CompressedImage", "cdr", messages)}, 100_000)


def long_folder(path: Path, clip: Path, frames: int = 250) -> Path:
    """An image folder that takes seconds: the clip, again and again."""
    pictures = sorted(clip.iterdir())
    path.mkdir(parents=True)
    for number in range(frames):
        (path / f"{number}.png").symlink_to(pictures[number % len(pictures)])
    return path


def report_of(out: Path) -> dict[str, dict[str, Any]]:
    """Rows of the report, by name."""
    return {row["name"]: row for row in pq.read_table(out / "report.parquet").to_pylist()}


def visible(out: Path) -> set[str]:
    """What a user sees in the output folder, but the report."""
    return {path.name for path in out.iterdir() if not path.name.startswith(".")} - {"report.parquet"}


def unfinished_pid(out: Path, name: str, seen: Collection[int] = ()) -> int:
    """The process that is in the middle of a recording; waits for one that has not been seen."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        for journal in out.glob(f".{name}.unfinished-*/results/tracks.parquet.unfinished"):
            for process in Path("/proc").glob("[0-9]*"):
                with suppress(OSError):  # it has ended
                    command = (process / "cmdline").read_text(errors="replace")
                    if journal.parents[1].name in command and int(process.name) not in seen:
                        return int(process.name)
        time.sleep(0.02)
    raise TimeoutError(f"{name} is not being run")

"""The first start on a machine: half of the code is compiled by a process beside."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from frontend.warm_up import _start_helper

TRACK = """
import numpy as np
from frontend.frame import Frame
from frontend.tracker import LineTracker
from frontend.warm_up import _is_cold
from frontend.tracking import appearance, assignment, borders, fragments, fusion, overlap
from airline import AirLine, LineSet, fit, reach, score
from airline.config import DetectorConfig, EdgeConfig
settings = DetectorConfig(edges=EdgeConfig(detector="canny"))
rng = np.random.default_rng(0)
segments = rng.uniform(0, 200, (40, 2, 2)).astype(np.float32)
ones, alike = np.ones(40, np.float32), np.eye(6, dtype=np.float32)[np.zeros(40, int)]
lines = LineSet(segments, ones, alike, ones)
image = rng.integers(0, 256, (200, 200), np.uint8)
tracker = LineTracker()
for index in range(3):
    tracker.update(Frame(index, index, image), lines)
kernels = [kernel for module in (appearance, assignment, borders, fragments, fusion, overlap)
           for kernel in vars(module).values() if hasattr(kernel, "stats")]
AirLine(config=settings)(image)
kernels += [fit._choose, fit._vote, reach.reach, score.score]
print(_is_cold(), *(sum(sum(kernel.stats.cache_misses.values()) for kernel in some) for some in (kernels, [fit.group])))
"""


def test_what_the_process_beside_compiles_is_what_is_needed(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-m", "frontend.warm_up"], env=environment, check=True, timeout=120)
    said = subprocess.run(
        [sys.executable, "-c", TRACK], env=environment, check=True, timeout=120, capture_output=True, text=True
    )
    assert said.stdout.split() == ["False", "0", "1"]


def test_where_no_process_starts_everything_is_compiled_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    assert _start_helper() is None

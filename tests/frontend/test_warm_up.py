"""The first start on a machine: half of the code is compiled by a process beside."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from airline.kernels.threads import cores
from frontend.warm_up import _start_helper

TRACK = """
import numpy as np
from frontend.frame import Frame
from frontend.tracker import LineTracker
from frontend.warm_up import _is_cold
from frontend.tracking import appearance, assignment, fusion, overlap
from airline import AirLine, LineSet, fit, reach, refine, score
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
kernels = [kernel for module in (appearance, assignment, fusion, overlap)
           for kernel in vars(module).values() if hasattr(kernel, "stats")]
AirLine(config=settings)(image)
kernels += [fit._choose, fit._vote, reach.reach, score.score, refine._refine, refine.blocks_of]
print(_is_cold(), *(sum(sum(kernel.stats.cache_misses.values()) for kernel in some) for some in (kernels, [fit.group])))
"""


@pytest.mark.parametrize(("share", "left"), [("half", "1"), ("all", "0")])
def test_what_the_process_beside_compiles_is_what_is_needed(tmp_path: Path, share: str, left: str) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "frontend.warm_up", share]
    subprocess.run(command, env=environment, check=True, timeout=120, stdout=subprocess.DEVNULL)
    said = subprocess.run(
        [sys.executable, "-c", TRACK], env=environment, check=True, timeout=120, capture_output=True, text=True
    )
    assert said.stdout.split() == ["False", "0", left]


COLD = """
import sys
from frontend import warm_up
started = []
start = warm_up._start_helper
warm_up._start_helper = lambda share: started.append(start(share)) or started[-1]
warm_up.compile_ahead()
with warm_up._using_helper() as wait:
    assert wait() == b"half\\n"
assert len(started) == 1 and started[0].returncode is not None and warm_up._helper is None
with warm_up._using_helper() as wait:
    wait()
assert started[1] is None, "nothing is left to compile"
"""


@pytest.mark.skipif(cores() < 2, reason="one core: everything is compiled by one process")
def test_what_was_started_ahead_is_waited_for_and_ended(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-W", "error", "-c", COLD], env=environment, check=True, timeout=120)


def test_where_no_process_starts_everything_is_compiled_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    monkeypatch.setattr("frontend.warm_up._is_cold", lambda: True)
    assert _start_helper("half") is None

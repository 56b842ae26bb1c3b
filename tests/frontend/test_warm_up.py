"""The first start on a machine: half of the code is compiled by a process beside."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from airline.kernels.threads import cores

TRACK = """
import numpy as np
from frontend.frame import Frame
from frontend.tracker import LineTracker
from frontend.tracking import appearance, assignment, fusion, overlap
from airline import AirLine, LineSet
from airline.stages import extend_ends, fit, refine, score_parts
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
kernels += [kernel for module in (extend_ends, score_parts, refine) for kernel in vars(module).values()
            if hasattr(kernel, "stats")]
print(sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels))
"""

COLD = """
from frontend import warm_up
warm_up.compile_ahead()
helper = warm_up._helper
assert helper.stdout.readline() == b"half\\n"
helper.kill()
helper.communicate()
warm_up._helper = None
warm_up.compile_ahead()
assert warm_up._helper is None, "nothing is left to compile"
"""


@pytest.mark.skipif(cores() < 2, reason="one core: everything is compiled by one process")
def test_what_the_process_beside_compiles_is_what_is_needed(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-W", "error", "-c", COLD], env=environment, check=True, timeout=300)
    said = subprocess.run(
        [sys.executable, "-c", TRACK], env=environment, check=True, timeout=300, capture_output=True, text=True
    )
    assert said.stdout == "0\n"

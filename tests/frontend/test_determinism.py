"""The same input gives the same bits: in another process, with code compiled anew, however the stages are run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from airline.kernels.threads import cores
from airline.network.runtimes import vector_instructions
from tests.helpers.command import ROOT

OURS = [] if vector_instructions() is None else ["native"]

DIGEST = """
import dataclasses, hashlib, sys
import numpy as np
from airline import AirLine
from frontend import LineFrontend, LineTracker, TrackerConfig, open_source
folder, runtime, threads, serial = sys.argv[1:]
if runtime == "torch":
    import torch
    torch.set_num_threads(int(threads))
digest = hashlib.sha256()
source = open_source(folder)
tracker = LineTracker(TrackerConfig(points=True))
frontend = LineFrontend(AirLine(runtime=runtime, threads=int(threads)), tracker)
for result in frontend.results(source, serial=serial == "serial"):
    for field in dataclasses.fields(result.tracks):
        value = getattr(result.tracks, field.name)
        digest.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
print(len(result.tracks), digest.hexdigest())
"""


def digest(clip: Path, runtime: str = "auto", threads: int = 1, how: str = "pipelined", **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", DIGEST, str(clip), runtime, str(threads), how],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    count, found = done.stdout.split()
    assert int(count) > 10
    return found


@pytest.mark.parametrize(("runtime", "threads"), [*((one, 2) for one in (*OURS, "openvino")), ("torch", 1)])
def test_every_start_gives_the_same_bits(clip: Path, runtime: str, threads: int) -> None:
    """Whether stages overlap or not, and with any number of the network's threads.

    But for torch, which divides its sums differently, on an AMD EPYC for one.
    """
    assert digest(clip, runtime) == digest(clip, runtime, threads, "serial")


@pytest.mark.slow
def test_code_that_is_compiled_anew_gives_the_same_bits(clip: Path, tmp_path: Path) -> None:
    cold = digest(clip, NUMBA_CACHE_DIR=str(tmp_path))
    assert digest(clip, NUMBA_CACHE_DIR=str(tmp_path)) == cold
    assert digest(clip) == cold


TRACK = """
import numpy as np
from frontend.frame import Frame
from frontend.tracker import LineTracker
from frontend.tracking import appearance, assignment, camera_motion, guided, measurement, overlap, state
from airline import AirLine, LineSet
from airline.stages import refine, score_parts
from airline.config import DetectorConfig, EdgeConfig
settings = DetectorConfig(edges=EdgeConfig(detector="canny"))
rng = np.random.default_rng(0)
segments = rng.uniform(0, 200, (40, 2, 2)).astype(np.float32)
ones, alike = np.ones(40, np.float32), np.eye(6, dtype=np.float32)[np.zeros(40, int)]
lines = LineSet(segments, ones, alike, ones)
image = rng.integers(0, 256, (200, 200), np.uint8)
tracker = LineTracker()
for index in range(3):
    tracker.update(Frame(index, index, image), lines, np.zeros(image.shape, np.float32))
kernels = [kernel for module in (appearance, assignment, camera_motion, guided, measurement, overlap, state)
           for kernel in vars(module).values() if hasattr(kernel, "stats")]
AirLine(config=settings)(image)
kernels += [kernel for module in (score_parts, refine) for kernel in vars(module).values()
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


@pytest.mark.slow
@pytest.mark.skipif(cores() < 2, reason="one core: everything is compiled by one process")
def test_what_the_process_beside_compiles_is_what_is_needed(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-W", "error", "-c", COLD], env=environment, check=True, timeout=300)
    said = subprocess.run(
        [sys.executable, "-c", TRACK], env=environment, check=True, timeout=300, capture_output=True, text=True
    )
    assert said.stdout == "0\n"

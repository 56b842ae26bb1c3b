"""The same input gives the same bits: in another process, with code compiled anew, however the stages are run.

`COLD=1 python -m pytest tests/frontend/test_determinism.py` compiles everything anew, which takes half a minute.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from airline.network.runtimes import vector_instructions
from tests.helpers.command import ROOT

OURS = [] if vector_instructions() is None else ["native"]

DIGEST = """
import dataclasses, hashlib, sys
import numpy as np
from airline import AirLine
from frontend import LineFrontend, open_source
folder, runtime, threads, serial = sys.argv[1:]
if runtime == "torch":
    import torch
    torch.set_num_threads(int(threads))
digest = hashlib.sha256()
source = open_source(folder)
for result in LineFrontend(AirLine(runtime=runtime, threads=int(threads))).results(source, serial=serial == "serial"):
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


@pytest.mark.parametrize("runtime", [*OURS, "openvino", "torch"])
def test_every_start_gives_the_same_bits(clip: Path, runtime: str) -> None:
    """Whether stages overlap or not."""
    first = digest(clip, runtime)
    assert digest(clip, runtime, how="serial") == first


@pytest.mark.parametrize("runtime", [*OURS, "openvino"])
def test_any_number_of_the_networks_threads_gives_the_same_bits(clip: Path, runtime: str) -> None:
    """Not in torch, which divides its sums differently, on an AMD EPYC for one."""
    assert digest(clip, runtime, threads=1) == digest(clip, runtime, threads=2)


@pytest.mark.skipif("COLD" not in os.environ, reason="compiles everything anew, half a minute: set COLD=1")
def test_code_that_is_compiled_anew_gives_the_same_bits(clip: Path, tmp_path: Path) -> None:
    cold = digest(clip, NUMBA_CACHE_DIR=str(tmp_path))
    assert digest(clip, NUMBA_CACHE_DIR=str(tmp_path)) == cold
    assert digest(clip) == cold

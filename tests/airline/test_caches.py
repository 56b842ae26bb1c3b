"""The cache of compiled code: changed sources, nowhere to keep it, a full disk, damaged files, cold and warm."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from airline.network.runtimes import vector_instructions
from tests.helpers.command import ROOT

KERNEL = """
from airline.kernels.compiled import njit
@njit()
def twice(x):
    return 2 * x
"""
USE = "import logging, kernel; logging.basicConfig(); assert kernel.twice(21) == 42; {then}"
HITS = "print(sum(kernel.twice.stats.cache_hits.values()))"
FULL = "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
FULL += "resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64)); "


def start(folder: Path, code: str, root: Path = ROOT, **environment: str) -> subprocess.Popen[str]:
    inherited = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    path = {"PYTHONPATH": f"{root}{os.pathsep}{folder}", "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", code],
        env={**inherited, **path, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )


def use(folder: Path, before: str = "", **environment: str) -> tuple[int, str]:
    """How often the cache was hit, and what was said."""
    (folder / "kernel.py").write_text(KERNEL)
    with start(folder, before + USE.format(then=HITS), **environment) as process:
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return int(out), err


CALLEE = """
from airline.kernels.compiled import njit
@njit({inline})
def number():
    return {number}
"""
CALLER = """
from airline.kernels.compiled import njit
from airline.kernels.callee import number
@njit()
def twice():
    return 2 * number()
"""


@pytest.mark.parametrize(("package", "inline"), [("airline", ""), ("frontend", 'inline="always"')])
def test_a_change_of_a_function_in_another_file_is_noticed(tmp_path: Path, package: str, inline: str) -> None:
    """And folders of what was before do not pile up."""
    kernels, caller = tmp_path / "airline" / "kernels", tmp_path / package / "caller.py"
    kernels.mkdir(parents=True)
    for name in ("__init__.py", "kernels/__init__.py", "kernels/compiled.py"):
        shutil.copy(ROOT / "airline" / name, tmp_path / "airline" / name)
    caller.parent.mkdir(exist_ok=True)
    (caller.parent / "__init__.py").touch()
    caller.write_text(CALLER)
    for number in range(5):
        (caller.parent / "__pycache__" / f"kernels-{number}").mkdir(parents=True)
    code = f"from {package}.caller import twice as f; print(f(), sum(f.stats.cache_hits.values()))"
    for number, hits in ((1, 0), (2, 0), (1, 1)):  # who goes back to what was before finds it compiled
        (kernels / "callee.py").write_text(CALLEE.format(number=number, inline=inline))
        with start(tmp_path, code, tmp_path) as process:
            out, err = process.communicate(timeout=60)
        assert (out.split(), err) == ([str(2 * number), str(hits)], "")
    assert len(list((caller.parent / "__pycache__").glob("kernels-*"))) == 3


def test_nowhere_to_keep_it_costs_a_warning(tmp_path: Path) -> None:
    """Read-only package and home: here folders below a file, as permissions do not stop root."""
    (tmp_path / "__pycache__").write_text("in the way")
    (tmp_path / "file").write_text("")
    nowhere = str(tmp_path / "file" / "below")
    hits, said = use(tmp_path, NUMBA_CACHE_DIR=nowhere, HOME=nowhere, XDG_CACHE_HOME=nowhere)
    assert hits == 0
    assert said.count("compiled code cannot be kept") == 1
    assert "there is no folder to keep it in" in said
    assert "set NUMBA_CACHE_DIR" in said


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs RLIMIT_FSIZE as on Linux")
def test_a_full_disk_costs_a_warning(tmp_path: Path) -> None:
    hits, said = use(tmp_path, before=FULL, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert hits == 0
    assert said.count("compiled code cannot be kept") == 1
    assert "File too large" in said


@pytest.mark.parametrize("part", [0.0, 0.95])
def test_damaged_files_are_compiled_anew(tmp_path: Path, part: float) -> None:
    cache = tmp_path / "cache"
    use(tmp_path, NUMBA_CACHE_DIR=str(cache))
    files = [path for path in cache.rglob("*.nb?") if path.is_file()]
    assert len(files) == 2
    for path in files:
        data = path.read_bytes()
        path.write_bytes(data[: int(part * len(data))])
    hits, _ = use(tmp_path, NUMBA_CACHE_DIR=str(cache))
    assert hits == 0


def test_processes_share_a_cold_cache(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    cache = str(tmp_path / "cache")
    processes = [start(tmp_path, USE.format(then=""), NUMBA_CACHE_DIR=cache) for _ in range(2)]
    for process in processes:
        with process:
            _, err = process.communicate(timeout=120)
        assert (process.returncode, err) == (0, "")
    assert use(tmp_path, NUMBA_CACHE_DIR=cache) == (1, "")


EDGES = """
import hashlib, numpy
from airline.network.runtimes import open_network
network = open_network("default", "native")
for image in numpy.load("images.npy"):
    print(hashlib.sha256(network(image).tobytes()).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.skipif(vector_instructions() is None, reason="needs a processor with AVX2")
def test_edges_are_the_same_bits_with_a_cold_and_a_warm_cache(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (6, 240, 320)).astype(np.float32)
    smooth = [cv2.GaussianBlur(image, (0, 0), 1 + k / 3) for k, image in enumerate(noise)]
    images = [cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8) for image in smooth]
    np.save(tmp_path / "images.npy", images)
    digests = []
    for _ in ("cold", "warm"):
        with start(tmp_path, EDGES, NUMBA_CACHE_DIR=str(tmp_path / "cache")) as process:
            out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        digests.append(out.split())
    assert len(set(digests[0])) == 6
    assert digests[0] == digests[1]

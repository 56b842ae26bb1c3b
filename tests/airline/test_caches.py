"""The cache of compiled code: nowhere to keep it, a full disk, damaged files, processes that share it from cold."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

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


def start(folder: Path, then: str = HITS, before: str = "", **environment: str) -> subprocess.Popen[str]:
    (folder / "kernel.py").write_text(KERNEL) if not (folder / "kernel.py").exists() else None
    inherited = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    path = {"PYTHONPATH": f"{ROOT}{os.pathsep}{folder}", "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", before + USE.format(then=then)],
        env={**inherited, **path, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )


def use(folder: Path, **options: str) -> tuple[int, str]:
    """How often the cache was hit, and what was said."""
    with start(folder, **options) as process:
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return int(out), err


def test_a_cache_is_used(tmp_path: Path) -> None:
    cache = str(tmp_path / "cache")
    assert use(tmp_path, NUMBA_CACHE_DIR=cache) == (0, "")
    assert use(tmp_path, NUMBA_CACHE_DIR=cache) == (1, "")


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


@pytest.mark.parametrize("part", [0.0, 0.5, 0.95])
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
    processes = [start(tmp_path, NUMBA_CACHE_DIR=cache) for _ in range(4)]
    for process in processes:
        with process:
            _, err = process.communicate(timeout=120)
        assert (process.returncode, err) == (0, "")
    assert use(tmp_path, NUMBA_CACHE_DIR=cache) == (1, "")

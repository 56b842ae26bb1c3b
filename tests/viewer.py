"""Whether this machine can draw the viewer, and the command that takes pictures."""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RERUN = Path(sys.executable).parent / "rerun"


def have_vulkan() -> bool:
    """Whether a Vulkan loader and at least one driver are installed."""
    folders = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"), Path("/usr/local/share/vulkan/icd.d"))
    return ctypes.util.find_library("vulkan") is not None and any(any(f.glob("*.json")) for f in folders)


needs_viewer = pytest.mark.skipif(
    not have_vulkan() or not RERUN.exists(),
    reason="needs the Rerun viewer and a Vulkan driver (Debian: mesa-vulkan-drivers libvulkan1)",
)


def snapshot(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """`python -m viz.snapshot` with these arguments."""
    return subprocess.run(
        [sys.executable, "-m", "viz.snapshot", *map(str, arguments)],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=90,
    )

"""What POSIX alone has: without it everything can be imported, and a run runs."""

from __future__ import annotations

import subprocess
import sys

from tests.helpers.command import ROOT

# Others' modules are imported before: they look at `sys.platform`, and what they do elsewhere is tested there.
_WITHOUT = """
import importlib, os, pkgutil, signal, socket, sys
import av, cv2, filelock, foxglove, kornia, matplotlib.pyplot, numba, openvino, pyarrow.parquet, pycolmap, ray, rerun
import rosbags.rosbag1, rosbags.rosbag2, scipy.optimize, torch, zmq

for module, names in {
    signal: ["SIGHUP", "SIGKILL", "SIGUSR1"],
    os: ["fork", "killpg", "getuid", "geteuid", "sched_getaffinity", "sched_setaffinity", "mkfifo"],
    socket: ["AF_UNIX"],
}.items():
    for name in names:
        delattr(module, name)
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None

for package in ("airline", "frontend", "logs", "viz"):
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)

from frontend.run import main
sys.exit(main(["--max-frames", "2", "--headless", "--save", sys.argv[1], "--out", sys.argv[2]]))
"""


def test_nothing_needs_what_posix_alone_has(tmp_path):
    files = [str(tmp_path / name) for name in ("run.rrd", "tracks.parquet")]
    done = subprocess.run([sys.executable, "-c", _WITHOUT, *files], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert all((tmp_path / name).stat().st_size > 1000 for name in ("run.rrd", "tracks.parquet"))

"""Runs the code blocks of a page in the present folder.

`python -m MODULE` runs inside this process, which loads everything once; all else goes to a shell. The Python blocks of
a page share their names, as a reader's session does.
"""

from __future__ import annotations

import io
import re
import runpy
import shlex
import subprocess
import sys
import threading
import time
import traceback
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from tests.helpers.pages import SHOWN, PageError, blocks_of
from tests.helpers.ports import free_port

SHELL_CHARACTERS = re.compile(r"[|<>;&$*?]")
TIMEOUT_S = 120


class Backend:
    """The reader's SLAM system: takes what the pages hand to it."""

    def add_lines(self, stamp_ns: int, ids: np.ndarray, segments: np.ndarray | None, *more: np.ndarray) -> None:
        assert segments is None or segments.shape == (len(ids), 2, 2)
        assert all(len(array) == len(ids) for array in more)

    def add_track(self, stamps_ns: np.ndarray, segments: np.ndarray, covariances: np.ndarray) -> None:
        assert segments.shape == covariances.shape == (len(stamps_ns), 2, 2)

    def make_landmarks(self, ids: np.ndarray) -> None:
        assert ids.dtype == np.int64

    def forget_lines(self, ids: np.ndarray) -> None:
        assert ids.dtype == np.int64


def names() -> dict[str, Any]:
    """What a page's Python blocks take as given."""
    import cv2
    import torch

    from frontend import CameraModel

    images = [cv2.imread(f"images/img{k}.png") for k in range(4)]
    camera, net = CameraModel(160, 120, 115.0, 115.0, 79.5, 59.5), torch.nn.Conv2d(1, 1, 3, padding=1)
    given = {"backend": Backend(), "image": images[0], "images": images, "camera": camera, "my_torch_net": net}
    return {**given, "__name__": "__main__"}


def run_command(command: str) -> str | None:
    """Run a line of a shell; what went wrong, or None."""
    unquoted = re.sub(r"'[^']*'", "", command)
    words = shlex.split(command)
    if words[:2] != ["python", "-m"] or SHELL_CHARACTERS.search(unquoted):
        done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=TIMEOUT_S)
        return None if done.returncode == 0 else f"exit code {done.returncode}\n{done.stdout}{done.stderr}"
    said = io.StringIO()
    before, sys.argv = sys.argv, words[2:]
    code: object = 0
    try:
        with redirect_stdout(said), redirect_stderr(said), warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*found in sys.modules")  # by an earlier command
            runpy.run_module(words[2], run_name="__main__", alter_sys=True)
    except SystemExit as stop:
        code = stop.code
    except Exception:
        code = traceback.format_exc()
    finally:
        sys.argv = before
    return None if code in (0, None) else f"exit code {code}\n{said.getvalue()}"


def run_python(text: str, given: dict[str, Any]) -> str | None:
    """Run a block of Python; what went wrong, or None."""
    if "__main__" in text:  # worker processes import its file
        Path("block.py").write_text(text)
        return run_command("python block.py")
    address = re.search(r"subscribe_tracks\(\"(\S+?)\"", text)
    if address:
        threading.Thread(target=publish, args=address.groups(), daemon=True).start()
    try:
        with redirect_stdout(io.StringIO()):
            exec(compile(text, "block", "exec"), given)
    except Exception:
        return traceback.format_exc()
    return None


def publish(address: str) -> None:
    """A run at the other end of the live stream."""
    from logs.sinks.open import open_publisher
    from tests.helpers.made_tracks import clip_results, write_tracks

    write_tracks(open_publisher(address, "clip"), clip_results()[:3])


def run_page(page: str) -> list[str]:
    """Run all blocks of a page; what went wrong."""
    failures: list[str] = []
    given = names() if "```python" in page else {}
    for port in ("5555", "8765"):
        page = page.replace(f":{port}", f":{free_port()}")
    page = page.replace("ipc:///tmp/lines", f"ipc://{Path('lines').absolute()}")
    for block in blocks_of(page):
        if block.language in SHOWN:
            continue
        if block.language not in ("sh", "python"):
            raise PageError(f"line {block.number}: write sh or python, not '{block.language}'")
        for number, text in block.commands():
            started = time.monotonic()
            failure = run_python(text, given) if block.language == "python" else run_command(text)
            print(f"{time.monotonic() - started:6.1f} s  {text.strip().splitlines()[0]}")
            if failure is not None:
                failures.append(f"line {number}: {text.strip()}\n{failure}")
    return failures

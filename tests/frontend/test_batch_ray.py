"""Batches on a Ray cluster of this machine."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.helpers.batch_logs import camera_log, long_folder, report_of, unfinished_pid, visible
from tests.helpers.command import python

pytest.importorskip("ray", reason="Ray is not installed")


def test_killed_workers_cost_no_recording(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One recording loses its worker once, another one always; Ray runs in the batch's process tree alone."""
    monkeypatch.setenv("HOME", str(tmp_path))  # Ray keeps a token there
    logs = [camera_log(tmp_path / f"{name}.mcap", clip) for name in "abcd"]
    (tmp_path / "d.mcap").write_bytes(b"broken")
    once, always = long_folder(tmp_path / "once", clip), long_folder(tmp_path / "always", clip, frames=4000)
    out = tmp_path / "out"
    arguments = [once, always, *logs, "--out", out, "--ray", "local"]
    child = python(*arguments, module="frontend.batch", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        os.kill(unfinished_pid(out, "once"), signal.SIGKILL)
        seen: set[int] = set()
        for _ in range(3):
            pid = unfinished_pid(out, "always", seen)
            seen.add(pid)
            os.kill(pid, signal.SIGKILL)
        shown, err = child.communicate(timeout=120)
    finally:
        child.kill()
    assert child.returncode == 1, err
    rows = report_of(out)
    assert {name: row["status"] for name, row in rows.items()} == {
        **dict.fromkeys(("a", "b", "c", "once"), "done"),
        **dict.fromkeys(("always", "d"), "failed"),
    }
    assert (rows["once"]["attempts"], rows["always"]["attempts"], rows["d"]["attempts"]) == (2, 3, 1)
    assert "worker" in rows["always"]["reason"]
    assert rows["once"]["frames"] == 250
    assert visible(out) == {"a", "b", "c", "once"}
    assert not list(out.glob(".*.unfinished-*"))
    assert "failed always: " in shown

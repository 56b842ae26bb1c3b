"""Batches that are interrupted, and batches whose processes are killed."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.helpers.batch_logs import camera_log, long_folder, report_of, unfinished_pid, visible
from tests.helpers.command import python

LONG_FRAMES = 250


@pytest.fixture
def inputs(clip: Path, tmp_path: Path) -> list[Path]:
    """A recording that takes seconds, between two short ones."""
    a, c = (camera_log(tmp_path / f"{name}.mcap", clip) for name in "ac")
    return [a, long_folder(tmp_path / "b", clip, LONG_FRAMES), c]


def start(inputs: list[Path], out: Path, *flags: object, **options: object) -> subprocess.Popen[str]:
    """A batch in a session of its own, as a foreground job of a shell."""
    return python(*inputs, "--out", out, *flags, module="frontend.batch", start_new_session=True, **options)


def ends(pid: int) -> bool:
    """Whether a process that is not our child ends within seconds."""
    for _ in range(200):
        if not Path(f"/proc/{pid}").exists():
            return True
        time.sleep(0.05)
    return False


def test_a_recording_whose_worker_is_killed_is_run_again(inputs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    child = start(inputs[:2], out, "--workers", 2, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    os.kill(unfinished_pid(out, "b"), signal.SIGKILL)
    _, err = child.communicate(timeout=120)
    assert child.returncode == 0
    assert "b: its worker was killed by SIGKILL" in err
    rows = report_of(out)
    assert {name: (row["status"], row["attempts"]) for name, row in rows.items()} == {
        "a": ("done", 1),
        "b": ("done", 2),
    }
    assert rows["b"]["frames"] == LONG_FRAMES
    assert not list(out.glob(".*.unfinished-*"))


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_keeps_what_is_finished(inputs: list[Path], tmp_path: Path, sign: signal.Signals) -> None:
    out = tmp_path / "out"
    child = start(inputs, out, "--workers", 1, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    worker = unfinished_pid(out, "b")
    if sign == signal.SIGINT:
        os.killpg(child.pid, sign)  # as a terminal does: the workers get it too
    else:
        child.send_signal(sign)
    shown, err = child.communicate(timeout=30)
    assert child.returncode == 130
    assert err.startswith("WARNING: interrupted")
    assert err.count("\n") == 1
    assert "pending" in shown
    assert {name: row["status"] for name, row in report_of(out).items()} == {
        "a": "done",
        "b": "pending",
        "c": "pending",
    }
    assert visible(out) == {"a"}
    assert not list(out.glob(".*.unfinished-*"))
    assert ends(worker)


def test_a_batch_that_is_killed_leaves_nothing_half_done(inputs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    child = start(inputs[:2], out, "--workers", 1)
    worker = unfinished_pid(out, "b")
    child.kill()
    assert child.wait() == -signal.SIGKILL
    assert visible(out) == {"a"}
    assert ends(worker)
    assert report_of(out).keys() == {"a", "b"}
    assert start(inputs[:2], out, "--workers", 1, stdout=subprocess.DEVNULL).wait(120) == 0
    assert visible(out) == {"a", "b"}
    assert not list(out.glob(".*.unfinished-*"))
    rows = report_of(out)
    assert {name: row["status"] for name, row in rows.items()} == {"a": "skipped", "b": "done"}
    assert rows["b"]["frames"] == LONG_FRAMES


def test_a_batch_runs_on_ray(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray", reason="Ray is not installed")
    monkeypatch.setenv("HOME", str(tmp_path))  # Ray keeps a token there
    (tmp_path / "broken.mcap").write_bytes(b"broken")
    logs, out = [camera_log(tmp_path / "a.mcap", clip), tmp_path / "broken.mcap"], tmp_path / "out"
    assert start(logs, out, "--ray", "local", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).wait(120) == 1
    assert {name: row["status"] for name, row in report_of(out).items()} == {"a": "done", "broken": "failed"}
    assert visible(out) == {"a"}


@pytest.mark.slow
def test_on_ray_killed_workers_cost_no_recording(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One recording loses its worker once, another one always; Ray runs in the batch's process tree alone."""
    pytest.importorskip("ray", reason="Ray is not installed")
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

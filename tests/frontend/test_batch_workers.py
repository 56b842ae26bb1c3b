"""Batches: worker processes, and what happens when they die."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from frontend.cli.settings import RunConfig
from frontend.fleet.job import Job, Recipe, Row
from frontend.fleet.local import LocalWorkers
from frontend.fleet.workers import ATTEMPTS, run_all
from tests.helpers.batch_work import act_by_name


@pytest.fixture
def workers() -> Iterator[LocalWorkers]:
    with closing(LocalWorkers(2, Recipe(RunConfig(), ("parquet",)), act_by_name)) as opened:
        yield opened


def job(name: str, folder: Path = Path("nowhere")) -> Job:
    return Job(name, f"/{name}", folder, {})


def run(workers: LocalWorkers, *names: str) -> dict[str, Row]:
    return {row.name: row for row in run_all(map(job, names), workers)}


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_workers_are_kept_for_many_recordings(workers: LocalWorkers) -> None:
    rows = run(workers, *map(str, range(20)))
    assert len(rows) == 20
    assert {(row.status, row.attempts) for row in rows.values()} == {("done", 1)}
    pids = {row.frames for row in rows.values()}
    assert len(pids) <= 2
    assert os.getpid() not in pids


def test_a_recording_that_kills_its_worker_fails_alone(workers: LocalWorkers) -> None:
    deaths = [f"signal-{int(signal.SIGKILL)}", f"signal-{int(signal.SIGSEGV)}", "exit-3", "exit-0"]
    rows = run(workers, "0", deaths[0], "1", *deaths[1:], "2", "3")
    assert {row.name for row in rows.values() if row.status == "done"} == {"0", "1", "2", "3"}
    reasons = [rows[name].reason or "" for name in deaths]
    for reason, words in zip(reasons, ("SIGKILL", "SIGSEGV", "exit code 3", "exit code 0"), strict=True):
        assert words in reason
    assert {(rows[name].status, rows[name].attempts) for name in deaths} == {("failed", ATTEMPTS)}


def test_a_worker_that_dies_while_it_is_idle_is_replaced(workers: LocalWorkers) -> None:
    pid = run(workers, "0")["0"].frames
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    row = run(workers, "1")["1"]
    assert row.status == "done"
    assert row.frames != pid


def test_closing_ends_what_is_running(workers: LocalWorkers, tmp_path: Path) -> None:
    waiting = job("wait", tmp_path / "pid")
    workers.start(waiting)
    while not (waiting.folder.exists() and waiting.folder.read_text()):
        time.sleep(0.02)
    pid = int(waiting.folder.read_text())
    assert is_alive(pid)
    workers.close()
    assert not is_alive(pid)

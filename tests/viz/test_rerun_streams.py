"""A process that makes many recordings, as a batch does, keeps the threads of none."""

from __future__ import annotations

import gc
from pathlib import Path

import pytest

from frontend.soak import resident_mb
from tests.helpers.command import recorded
from tests.helpers.moving_rectangle import frame_results
from viz.rerun_sink import RerunSink

TASKS = Path("/proc/self/task")


@pytest.mark.skipif(not TASKS.exists(), reason="the system does not list threads")
def test_closed_recordings_leave_no_threads(tmp_path: Path) -> None:
    """Rerun keeps four for each, and some megabytes, unless it is told otherwise."""
    results = list(frame_results(4))
    threads, memory_mb = [], []
    for _ in range(10):
        sink = RerunSink(save=tmp_path / "run.rrd")
        for result in results:
            sink.write(result)
        sink.close()
        del sink
        gc.collect()
        threads.append(len(list(TASKS.iterdir())))
        memory_mb.append(resident_mb())
    assert max(threads[5:]) <= threads[1] + 4
    assert memory_mb[-1] - memory_mb[4] < 40
    assert recorded(tmp_path / "run.rrd")["/camera/tracks"]["frame"] == [0, 1, 2, 3]

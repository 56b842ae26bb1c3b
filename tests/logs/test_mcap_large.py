"""Large MCAP logs: memory does not grow with the file, and seeking does not take longer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

ROOT = Path(__file__).parents[2]
IMAGE_BYTES = 640 * 480 + 100
STEP_NS = 10_000_000
READ = """
import json, re, sys, time
from pathlib import Path
from logs.files.mcap_file import McapFile

path, start_ns = sys.argv[1], int(sys.argv[2])
began = time.perf_counter()
log = McapFile(path)
opened = time.perf_counter()
first = next(log.messages("/camera", start_ns))
found = time.perf_counter()
count = sum(len(message.data) == len(first.data) for message in log.messages("/camera"))
peak_mb = int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1024
figures = {"open_s": opened - began, "seek_s": found - opened, "first_ns": first.log_ns}
print(json.dumps({**figures, "count": count, "peak_mb": peak_mb}))
"""


def write(path: Path, count: int, compression: CompressionType) -> int:
    """A log of one camera, one image in three of the size of noise; returns the time of its last message."""
    images = [np.random.default_rng(number).bytes(IMAGE_BYTES) for number in range(3)]
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        channel = writer.register_channel("/camera", "cdr", writer.register_schema("sensor_msgs/msg/Image", "", b""))
        for number in range(count):
            writer.add_message(channel, number * STEP_NS, images[number % 3], number * STEP_NS, number)
        writer.finish()
    return (count - 1) * STEP_NS


def read(path: Path, start_ns: int) -> dict[str, float]:
    """Figures of a process of its own that seeks and then reads everything."""
    command = [sys.executable, "-c", READ, path, str(start_ns)]
    return json.loads(subprocess.check_output(command, env={**os.environ, "PYTHONPATH": str(ROOT)}))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak memory of a process is in /proc")
@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize(
    ("megabytes", "compression", "memory_mb"),
    [
        (200, CompressionType.NONE, 30),
        (200, CompressionType.LZ4, 30),
        pytest.param(
            3000,
            CompressionType.NONE,
            300,
            marks=pytest.mark.skipif("AIRLINE_LARGE_LOG" not in os.environ, reason="set AIRLINE_LARGE_LOG=1"),
        ),
    ],
)
def test_large_log(tmp_path: Path, megabytes: int, compression: CompressionType, memory_mb: int, cut: bool) -> None:
    small, large = tmp_path / "small.mcap", tmp_path / "large.mcap"
    count = megabytes * 10**6 // IMAGE_BYTES + 1
    write(small, 30, compression)
    end_ns = write(large, count, compression)
    try:
        if cut:
            os.truncate(large, large.stat().st_size - 400_000)
            end_ns -= 10 * STEP_NS
        figures = read(large, end_ns - 5 * STEP_NS)
    finally:
        large.unlink()
    assert figures["first_ns"] == end_ns - 5 * STEP_NS
    assert figures["count"] == count if not cut else count - 6 < figures["count"] < count
    assert figures["seek_s"] < 2
    assert cut or figures["open_s"] < 2
    assert figures["peak_mb"] < read(small, 0)["peak_mb"] + memory_mb

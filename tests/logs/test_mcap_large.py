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
import json, sys, time
from pathlib import Path
from logs.files.mcap_file import McapFile

def peak():
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")]
    return int(line.split()[1]) / 1024

path, start_ns, size = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
began = time.perf_counter()
log = McapFile(path)
opened = time.perf_counter()
first = next(log.messages("/camera", start_ns))
found = time.perf_counter()
count = sum(len(message.data) == size for message in log.messages("/camera"))
read = time.perf_counter()
print(json.dumps({
    "open_s": opened - began, "seek_s": found - opened, "read_s": read - found,
    "first_ns": first.log_ns, "count": count, "peak_mb": peak(), "lost": dict(log.lost),
}))
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
    result = subprocess.run(
        [sys.executable, "-c", READ, path, str(start_ns), str(IMAGE_BYTES)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    figures: dict[str, float] = json.loads(result.stdout)
    print(path.stat().st_size, figures)
    return figures


def check(folder: Path, size: int, compression: CompressionType, memory_mb: float, *, cut: bool = False) -> None:
    if not Path("/proc/self/status").exists():
        pytest.skip("the peak memory of a process is read from /proc")
    small, large = folder / "small.mcap", folder / "large.mcap"
    count = size // IMAGE_BYTES + 1
    write(small, 30, compression)
    end_ns = write(large, count, compression)
    try:
        assert large.stat().st_size >= size
        if cut:
            os.truncate(large, large.stat().st_size - 400_000)
            end_ns -= 10 * STEP_NS
        figures = read(large, end_ns - 5 * STEP_NS)
        assert figures["first_ns"] == end_ns - 5 * STEP_NS
        assert figures["count"] == count if not cut else count - 6 < figures["count"] < count
        assert figures["seek_s"] < 2
        assert cut or figures["open_s"] < 2
        assert figures["peak_mb"] < read(small, 0)["peak_mb"] + memory_mb
    finally:
        large.unlink()


@pytest.mark.parametrize(
    ("compression", "cut"), [(CompressionType.NONE, False), (CompressionType.NONE, True), (CompressionType.LZ4, False)]
)
def test_200_megabytes(tmp_path: Path, compression: CompressionType, cut: bool) -> None:
    check(tmp_path, 200_000_000, compression, 30, cut=cut)


@pytest.mark.skipif("AIRLINE_LARGE_LOG" not in os.environ, reason="set AIRLINE_LARGE_LOG=1 to write and read 3 GB")
@pytest.mark.parametrize("cut", [False, True])
def test_3_gigabytes(tmp_path: Path, cut: bool) -> None:
    check(tmp_path, 3_000_000_000, CompressionType.NONE, 300, cut=cut)

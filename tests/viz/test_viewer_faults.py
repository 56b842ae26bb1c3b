"""Viewers that are absent, stuck or killed: one warning, a complete file, no delay; and what a killed run leaves."""

from __future__ import annotations

import logging
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from airline.errors import ConfigError, InputError
from tests.helpers.command import ROOT, command, python, recorded
from tests.helpers.ports import free_port, listening
from tests.helpers.viewer import FRAMES, RERUN, record, saving_viewer, serving, viewers
from viz.rerun_sink import RerunSink

needs_rerun = pytest.mark.skipif(not RERUN.exists(), reason="Rerun's programs are not installed beside this Python")


@pytest.fixture
def long_clip(clip: Path, tmp_path: Path) -> Path:
    """The clip, over and over, for several seconds."""
    folder = tmp_path / "long"
    folder.mkdir()
    pictures = [path.read_bytes() for path in sorted(clip.glob("*.png"))]
    for number in range(320):
        (folder / f"{number}.png").write_bytes(pictures[number % len(pictures)])
    return folder


@contextmanager
def mute_port() -> Iterator[int]:
    """A port that takes connections and never reads."""
    held = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def accept() -> None:
            while True:
                try:
                    held.append(listener.accept()[0])
                except OSError:
                    return

        threading.Thread(target=accept, daemon=True).start()
        yield listener.getsockname()[1]
        listener.shutdown(socket.SHUT_RDWR)
    for connection in held:
        connection.close()


def frames_in(path: Path) -> list[int]:
    return recorded(path)["/camera/tracks"]["frame"]


def test_nobody_there_costs_one_warning(tmp_path, caplog):
    begin = time.monotonic()
    with caplog.at_level(logging.WARNING):
        rows = record(tmp_path / "run.rrd", connect=f"127.0.0.1:{free_port()}")
    assert time.monotonic() - begin < 5
    (warning,) = caplog.records
    assert "going on without it" in warning.getMessage()
    assert rows["/camera/tracks"]["frame"] == list(range(FRAMES))
    assert "no Rerun viewer answers" in rows["/log"]["TextLog:text"][0][0]


@pytest.mark.parametrize("options", [{"image": "raw"}, {"image": "none", "every": FRAMES, "descriptor_every": 0}])
def test_a_port_that_never_reads_costs_one_warning_and_few_seconds(tmp_path, caplog, options):
    """Much data waits in a flush; little leaves this process at once, and Rerun's goodbye waits."""
    begin = time.monotonic()
    with caplog.at_level(logging.WARNING), mute_port() as port:
        rows = record(tmp_path / "run.rrd", connect=f"127.0.0.1:{port}", **options)
    assert time.monotonic() - begin < 12
    (warning,) = caplog.records
    assert "takes no data" in warning.getMessage()
    assert rows["/camera/tracks"]["frame"] == list(range(0, FRAMES, options.get("every", 1)))


def test_a_stuck_viewer_does_not_make_the_run_grow():
    """Uncompressed frames: without a bound, everything would be kept for it. Nobody closes the sink: that holds up
    nothing, either."""
    script = f"""
import resource, sys, time
import viz.destination
from tests.helpers.moving_rectangle import frame_results
from viz.rerun_sink import RerunSink
viz.destination.PATIENCE_S = 1.0
sink = RerunSink(connect="127.0.0.1:" + sys.argv[1], image="raw")
results = list(frame_results({FRAMES}))
peaks = []
for number in range(1200):
    sink.write(results[number % {FRAMES}])
    time.sleep(0.005)
    if number % 600 == 599:
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
print(peaks[1] - peaks[0])
"""
    with mute_port() as port:
        command = [sys.executable, "-c", script, str(port)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0
    assert float(done.stdout) < 40, "MB; 600 frames are 140"
    assert done.stderr.count("going on without it") == 1


@needs_rerun
@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGSTOP])
def test_a_viewer_that_fails_in_the_middle(long_clip, tmp_path, sign):
    port, path = free_port(), tmp_path / "run.rrd"
    with (
        serving(port, "--serve-grpc") as viewer,
        python(long_clip, "--save", path, "--connect", f"127.0.0.1:{port}", stdout=-1, stderr=-1) as run,
    ):
        while not path.exists() or path.stat().st_size < 200_000:
            assert run.poll() is None
            time.sleep(0.02)
        os.killpg(viewer.pid, sign)
        out, err = run.communicate(timeout=120)
    assert run.returncode == 0
    assert err.count("\n") == 1, err
    assert "lost the Rerun viewer" in err
    assert f"saved {path}" in out
    assert frames_in(path) == list(range(320))


@needs_rerun
def test_a_viewer_receives_what_is_saved(clip, tmp_path, caplog):
    port, received = free_port(), tmp_path / "received.rrd"
    with saving_viewer(port, received), caplog.at_level(logging.WARNING):
        done = command(clip, "--save", tmp_path / "run.rrd", "--connect", f"rerun+http://127.0.0.1:{port}/proxy")
    assert done.code == 0
    assert not caplog.records
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the viewer was killed: its file has no footer
        there, here = recorded(received), recorded(tmp_path / "run.rrd")
    for path in ("/camera/tracks", "/camera/image", "/stats/counts/lines"):
        assert there[path]["frame"] == here[path]["frame"]
    assert there["/camera/tracks"]["LineStrips2D:strips"] == here["/camera/tracks"]["LineStrips2D:strips"]


@needs_rerun
def test_serving_is_for_this_machine_alone_and_goes_on_until_it_is_interrupted(clip, tmp_path):
    path = tmp_path / "run.rrd"
    with python(clip, "--serve", "--save", path, stdout=-1, stderr=-1) as run:
        lines = []
        for line in run.stdout:
            lines.append(line)
            if line.startswith("serving at"):
                break
        ports = [int(re.search(r"127\.0\.0\.1:(\d+)", line)[1]) for line in lines[:2]]  # for browsers, and viewers
        assert [listening(port) for port in ports] == [{"0100007F"}] * 2
        with socket.create_connection(("127.0.0.1", ports[0])) as browser:
            browser.sendall(b"GET / HTTP/1.0\r\n\r\n")
            assert b"200 OK" in browser.recv(100)
        assert viewers(ports[1])
        assert run.poll() is None
        run.send_signal(signal.SIGINT)
        _, err = run.communicate(timeout=20)
    assert (run.returncode, err) == (0, "")
    until = time.monotonic() + 10  # a process that was killed takes a moment to go
    while viewers(ports[1]) or listening(ports[1]):
        assert time.monotonic() < until
        time.sleep(0.02)
    assert frames_in(path) == list(range(8))


@needs_rerun
def test_a_killed_run_leaves_all_but_the_last_second_and_can_be_mended(long_clip, tmp_path):
    path, mended = tmp_path / "run.rrd", tmp_path / "mended.rrd"
    with python(long_clip, "--save", path, stdout=-1, stderr=-1) as run:
        while not path.exists() or path.stat().st_size < 400_000:
            assert run.poll() is None
            time.sleep(0.02)
        time.sleep(2)
        before = path.stat().st_size
        os.kill(run.pid, signal.SIGKILL)
    assert before > 400_000
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "no footer": that is what is mended
        left = recorded(path)
    ends = {entity: rows["frame"][-1] for entity, rows in left.items() if "frame" in rows}
    assert left["/camera/tracks"]["frame"] == list(range(ends["/camera/tracks"] + 1))
    subprocess.run([RERUN, "rrd", "optimize", path, "-o", mended], check=True, capture_output=True)
    assert subprocess.run([RERUN, "rrd", "verify", mended], capture_output=True).returncode == 0
    assert frames_in(mended) == left["/camera/tracks"]["frame"]


def test_unusable_targets_are_refused_before_any_work(tmp_path):
    with pytest.raises(InputError, match="cannot write the recording"):
        RerunSink(save=tmp_path / "missing" / "run.rrd")
    with pytest.raises(InputError, match="Is a directory"):
        RerunSink(save=tmp_path)
    with pytest.raises(ConfigError, match="nowhere"):
        RerunSink()
    for address in ("viewer", "127.0.0.1:port", "http://127.0.0.1:9876/proxy", "rerun+http://127.0.0.1:9876/x"):
        with pytest.raises(ConfigError, match="HOST:PORT"):
            RerunSink(connect=address)


def test_viewers_exclude_each_other(clip):
    outcome = command(clip, "--serve", "--connect", "127.0.0.1:9876")
    assert outcome.code == 2
    assert "not allowed with" in outcome.err

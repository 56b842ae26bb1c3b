"""Rerun's viewer: its window; absent, stuck or killed it costs one warning; and what a killed run leaves."""

from __future__ import annotations

import logging
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from airline.errors import ConfigError, InputError
from tests.helpers.batch_logs import long_folder
from tests.helpers.command import ROOT, command, python, recorded, refusal
from tests.helpers.ports import free_port, listening
from tests.helpers.viewer import FRAMES, RERUN, record, saving_viewer, serving, viewers
from viz.rerun_sink import RerunSink
from viz.viewer import open_viewer, start, stop

needs_rerun = pytest.mark.skipif(not RERUN.exists(), reason="Rerun's programs are not installed beside this Python")


LONG_FRAMES = 200


@pytest.fixture
def long_clip(clip: Path, tmp_path: Path) -> Path:
    """The clip, over and over, for several seconds."""
    return long_folder(tmp_path / "long", clip, LONG_FRAMES)


@contextmanager
def mute_port() -> Iterator[int]:
    """A port that takes connections and never reads."""
    with socket.create_server(("127.0.0.1", 0)) as listener:  # the kernel takes them
        yield listener.getsockname()[1]


def frames_in(path: Path) -> list[int]:
    return sorted(set(recorded(path)["/camera/tracks"]["frame"]))  # once, where lines and their ids are apart


def warnings_in(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [said.getMessage() for said in caplog.records if said.levelno >= logging.WARNING]


def wait_for_bytes(path: Path, run: subprocess.Popen[str], size: int) -> None:
    while not path.exists() or path.stat().st_size < size:
        assert run.poll() is None
        time.sleep(0.02)


def test_nobody_there_costs_one_warning(tmp_path, caplog):
    rows = record(tmp_path / "run.rrd", connect=f"127.0.0.1:{free_port()}")
    (warning,) = warnings_in(caplog)
    assert "going on without it" in warning
    assert rows["/camera/tracks"]["frame"] == list(range(FRAMES))
    assert "no Rerun viewer answers" in rows["/log"]["TextLog:text"][0][0]


@pytest.mark.parametrize("options", [{"image": "raw"}, {"image": "none", "every": FRAMES, "descriptor_every": 0}])
def test_a_port_that_never_reads_costs_one_warning_and_few_seconds(tmp_path, caplog, options):
    """Much data waits in a flush; little leaves this process at once, and Rerun's goodbye waits."""
    begin = time.monotonic()
    with mute_port() as port:
        rows = record(tmp_path / "run.rrd", connect=f"127.0.0.1:{port}", **options)
    assert time.monotonic() - begin < 12
    (warning,) = warnings_in(caplog)
    assert "takes no data" in warning
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
        wait_for_bytes(path, run, 200_000)
        os.killpg(viewer.pid, sign)
        out, err = run.communicate(timeout=120)
    assert run.returncode == 0
    assert err.count("\n") == 1, err
    assert "lost the Rerun viewer" in err
    assert f"saved {path}" in out
    assert frames_in(path) == list(range(LONG_FRAMES))


@needs_rerun
def test_a_viewer_receives_what_is_saved(clip, tmp_path, caplog):
    port, received = free_port(), tmp_path / "received.rrd"
    with saving_viewer(port, received):
        done = command(clip, "--save", tmp_path / "run.rrd", "--connect", f"rerun+http://127.0.0.1:{port}/proxy")
    assert done.code == 0
    assert warnings_in(caplog) == []
    there, here = recorded(received), recorded(tmp_path / "run.rrd")
    for path in ("/camera/tracks", "/camera/image", "/stats/counts"):
        assert there[path]["frame"] == here[path]["frame"]
    assert there["/camera/tracks"]["LineStrips2D:strips"] == here["/camera/tracks"]["LineStrips2D:strips"]


@needs_rerun
def test_serving_is_for_this_machine_alone_and_goes_on_until_it_is_interrupted(clip, tmp_path):
    path = tmp_path / "run.rrd"
    with python(clip, "--serve", "--save", path, stdout=-1, stderr=-1) as run:
        said = ""
        while "serving at" not in said:
            said += run.stdout.readline()
        ports = [int(port) for port in re.findall(r"127\.0\.0\.1:(\d+)", said)[:2]]  # for browsers, and viewers
        assert [listening(port) for port in ports] == [{"0100007F"}] * 2
        with urllib.request.urlopen(f"http://127.0.0.1:{ports[0]}") as answer:
            assert answer.status == 200
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
        wait_for_bytes(path, run, 400_000)
        time.sleep(2)
        os.kill(run.pid, signal.SIGKILL)
    frames = frames_in(path)
    assert frames == list(range(len(frames)))
    assert path.stat().st_size > 400_000
    subprocess.run([RERUN, "rrd", "optimize", path, "-o", mended], check=True, capture_output=True)
    assert subprocess.run([RERUN, "rrd", "verify", mended], capture_output=True).returncode == 0
    assert frames_in(mended) == frames


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
    assert "not allowed with" in refusal(clip, "--serve", "--connect", "127.0.0.1:9876")


def test_a_dead_display_opens_nothing_and_saves_a_file_instead(monkeypatch, clip, tmp_path, caplog):
    monkeypatch.setenv("DISPLAY", ":4077")  # a screen that is not there
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.chdir(tmp_path)
    port = free_port()
    monkeypatch.setattr("viz.viewer.open_viewer", partial(open_viewer, port))
    assert command(clip, "--max-frames", "2").code == 0
    assert viewers(port) == []
    assert "no viewer window could be opened: saving room.rrd instead" in caplog.text
    assert (tmp_path / "room.rrd").stat().st_size > 1000


@pytest.mark.skipif(not shutil.which("Xvfb"), reason="needs a virtual screen (Debian: xvfb)")
def test_a_window_opens_and_is_used_again(monkeypatch):
    number = 90 + os.getpid() % 900
    screen = subprocess.Popen(["Xvfb", f":{number}", "-screen", "0", "1024x768x24"], stderr=subprocess.DEVNULL)
    monkeypatch.setenv("DISPLAY", f":{number}")
    port = free_port()
    try:
        deadline = time.monotonic() + 10
        while not Path(f"/tmp/.X11-unix/X{number}").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert open_viewer(port) == f"127.0.0.1:{port}"
        assert listening(port) == {"0100007F"}, "other machines must not reach the viewer"
        running = viewers(port)
        assert len(running) >= 1
        assert open_viewer(port) == f"127.0.0.1:{port}"
        assert viewers(port) == running, "the open window is used, no second one comes"
    finally:
        for process in viewers(port):
            os.kill(process, signal.SIGKILL)
        screen.terminate()
        screen.wait()


def test_the_viewer_reports_to_nobody():
    viewer = start(free_port(), "--headless", output=subprocess.PIPE, RUST_LOG="re_analytics=debug")
    if viewer is None:
        pytest.skip("Rerun's viewer is not installed beside this Python")
    with viewer:
        watchdog = threading.Timer(30, stop, [viewer])
        watchdog.start()
        try:
            said = next((line for line in viewer.stdout if b"nalytics" in line), b"nothing")
        finally:
            watchdog.cancel()
            stop(viewer)
    assert b"Analytics disabled" in said


def test_without_the_viewer_program_nothing_opens(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    assert open_viewer(free_port()) is None

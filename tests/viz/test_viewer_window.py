"""Opening the viewer's window: on a screen, and where there is none."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from tests.helpers.command import command
from tests.helpers.ports import free_port, listening
from tests.helpers.viewer import viewers
from viz.viewer import open_viewer, start, stop


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

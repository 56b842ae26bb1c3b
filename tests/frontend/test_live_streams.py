"""Network streams that drop, stall and come back, from a server on this machine; a camera that is not there."""

from __future__ import annotations

import json
import signal
import threading
import time
from itertools import islice, pairwise
from pathlib import Path

import pytest

from airline.errors import ConfigError, InputError
from frontend.pipeline import LineFrontend
from frontend.sources import live, open_source
from frontend.sources.live import LiveSource
from logs import read_tracks
from tests.helpers.command import command, python
from tests.helpers.mjpeg_server import mjpeg_server


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_FIRST_WAIT_S", 0.02)
    monkeypatch.setattr(live, "_LONGEST_WAIT_S", 0.2)


def test_a_stream_that_drops_is_opened_again(caplog: pytest.LogCaptureFixture) -> None:
    with mjpeg_server() as server:
        server.frames = 6
        source = LiveSource(server.url)
        assert source.live
        frames = []
        for frame in source:
            frames.append(frame)
            if len(frames) == 3:
                server.refused = 2
            if len(frames) == 15:
                break
        source.close()
    assert [frame.index for frame in frames] == list(range(15))
    assert all(first.stamp_ns < second.stamp_ns for first, second in pairwise(frames))
    assert source.reconnects == 2
    assert server.connections == 5, "two that were refused among them"
    messages = [record.getMessage() for record in caplog.records]
    assert [("was lost: trying" in message, "is back after" in message) for message in messages] == [
        (True, False),
        (False, True),
    ] * 2


def test_a_stream_that_does_not_come_back_is_an_error_behind_its_frames() -> None:
    with mjpeg_server() as server:
        server.frames = 5
        source = LiveSource(server.url, reconnect_s=0.5)
        read = []
        begin = time.monotonic()
        frames = iter(source)
        read.append(next(frames))
        server.refused = 1000
        with pytest.raises(InputError, match=r"did not come back within 0\.5 s.*--reconnect"):
            read.extend(frames)
        assert time.monotonic() - begin < 4
        source.close()
    assert 3 <= len(read) <= 5
    assert 3 <= server.connections <= 12, "the waits grow"


def test_without_reconnecting_the_end_of_a_stream_is_the_end() -> None:
    with mjpeg_server() as server:
        server.frames = 5
        source = open_source(server.url, reconnect_s=0)
        assert 3 <= len(list(source)) <= 5
        source.close()
    with pytest.raises(ConfigError, match="0 or more seconds"):
        LiveSource("http://127.0.0.1:9/", reconnect_s=-1)


def test_a_stream_that_stalls_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_TIMEOUT_MS", 400)
    with mjpeg_server() as server:
        source = LiveSource(server.url)
        frames = []
        begin = time.monotonic()
        for frame in source:
            frames.append(frame)
            server.stalled = len(frames) == 5
            if server.stalled:
                threading.Timer(0.5, setattr, (server, "stalled", False)).start()
            if len(frames) == 10:
                break
        source.close()
        assert time.monotonic() - begin < 8
    assert source.reconnects == 1


def test_closing_ends_the_wait_for_a_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_FIRST_WAIT_S", 30.0)
    monkeypatch.setattr(live, "_LONGEST_WAIT_S", 30.0)
    with mjpeg_server() as server:
        server.frames = 4
        tracks = LineFrontend().stream(LiveSource(server.url), max_latency_s=10)
        assert len(list(islice(tracks, 1))) == 1
        time.sleep(0.5)
        begin = time.monotonic()
        tracks.close()
        assert time.monotonic() - begin < 3


def test_a_run_goes_on_when_its_stream_comes_back(tmp_path: Path) -> None:
    """The gap ends all tracks, the summary counts it, SIGTERM ends the run with complete files."""
    out, figures = tmp_path / "t.parquet", tmp_path / "s.json"
    with mjpeg_server() as server:
        server.frames = 60
        flags = ["--out", out, "--summary", figures, "--max-latency", 5]
        with python(server.url, *flags, stdout=-1, stderr=-1) as run:
            deadline = time.monotonic() + 60
            while server.connections < 2 and time.monotonic() < deadline:
                time.sleep(0.05)
                server.refused = 3 if server.connections == 1 else server.refused
            while server.connections < 6 and time.monotonic() < deadline:
                time.sleep(0.05)
            time.sleep(1)
            run.send_signal(signal.SIGTERM)
            printed, said = run.communicate(timeout=30)
    assert run.returncode == 143
    assert "the stream was lost: trying to reconnect for 60 s" in said
    assert "the stream is back after" in said
    assert "reconnects)" in printed
    assert json.loads(figures.read_text())["reconnects"] >= 1
    resets = [tracks.reset for tracks in read_tracks(out) if tracks.reset]
    assert any(reset.startswith("gap of") for reset in resets)


def test_info_of_a_live_stream() -> None:
    with mjpeg_server() as server:
        done = command(server.url, "--info")
    assert done.code == 0
    rows = dict(line.split(":", 1) for line in done.out.splitlines())
    assert rows["kind"].strip() == "live stream"
    assert rows["frames"].strip() == "live, no end"
    assert "UTC" in rows["first time"]


def test_a_camera_that_is_pulled_out_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """No machine of the tests has a camera: a stream that ends stands for one."""
    with mjpeg_server() as server:
        server.frames = 5
        url, opened = server.url, live._open
        monkeypatch.setattr(live, "_open", lambda number: opened(url))
        frames = iter(LiveSource(3))
        assert next(frames).index == 0
        with pytest.raises(InputError, match="camera 3 sends no more pictures: is it still connected"):
            list(frames)


def test_a_run_whose_stream_is_lost_keeps_what_it_has(tmp_path: Path) -> None:
    with mjpeg_server() as server:
        server.frames = 40
        threading.Timer(0.2, setattr, (server, "refused", 1000)).start()
        done = command(server.url, "--out", tmp_path / "t.csv", "--reconnect", 0.3, "--max-latency", 5)
    assert done.code == 2
    assert "did not come back within 0.3 s" in done.err
    assert "wrote" in done.out
    assert len((tmp_path / "t.csv").read_text().splitlines()) > 4

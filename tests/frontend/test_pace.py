"""Frames that wait for nobody: when they come, which are dropped, and that waiting ends."""

from __future__ import annotations

import logging
import subprocess
import sys
import threading
import time
from contextlib import closing
from itertools import islice

import numpy as np
import pytest

from airline import AirLine, CannyEdges, InputError
from frontend import Frame, LineFrontend, Source
from frontend.cli.settings import load
from frontend.cli.wiring import open_input
from frontend.sources.pace import FreshFrames, RealtimeSource
from frontend.sources.wrapped import Peeked
from tests.helpers.command import ROOT
from tests.helpers.live_camera import PERIOD_S, Camera, SlowEdges, pictures
from tests.helpers.sources import Listed

STAMPS_MS = [100, 140, 150, 400, 410]  # since when does not matter
HOUR_MS = 3_600_000


def recording(stamps_ms: list[int], cost_s: float = 0.0) -> Listed:
    image = np.zeros((16, 16), np.uint8)
    return Listed([Frame(k, stamp * 10**6, image) for k, stamp in enumerate(stamps_ms)], cost_s=cost_s)


def arrivals_ms(source: Source, prepare_s: float = 0.0) -> list[float]:
    """When each frame came, since the second one was asked for."""
    frames = iter(source)
    next(frames)
    time.sleep(prepare_s)
    begin = time.perf_counter()
    return [1e3 * (time.perf_counter() - begin) for _ in frames]


@pytest.mark.parametrize("prepare_s", [0.0, 0.3])
def test_frames_come_when_they_are_due(prepare_s: float) -> None:
    found = arrivals_ms(RealtimeSource(recording(STAMPS_MS)), prepare_s)
    late = np.subtract(found, np.subtract(STAMPS_MS[1:], STAMPS_MS[0]))
    assert late.min() > -1, "never early"
    assert np.median(late) < 20


def test_late_frames_come_at_once() -> None:
    assert arrivals_ms(RealtimeSource(recording(STAMPS_MS, cost_s=0.15)))[-1] > 550
    assert list(RealtimeSource(recording([]))) == []


def test_closing_ends_a_wait() -> None:
    source = RealtimeSource(recording([0, HOUR_MS], cost_s=0.01))
    frames = iter(source)
    next(frames)
    threading.Timer(0.2, source.close).start()
    begin = time.monotonic()
    assert next(frames, None) is None
    assert time.monotonic() - begin < 5


def test_the_flag_makes_the_input_live() -> None:
    clip = RealtimeSource(recording(STAMPS_MS))
    assert clip.live
    source = open_input(None, load(None, {"input": {"realtime": True, "max_frames": 3}}))
    assert isinstance(source, FreshFrames)
    assert (source.live, source.name, source.frame_count, source.skipped) == (True, "corridor", 3, 0)
    serial = open_input(None, load(None, {"input": {"realtime": True, "max_frames": 3}, "serial": True}))
    assert isinstance(serial, RealtimeSource), "in series nothing is dropped"


def test_a_recording_waits_until_everything_is_ready() -> None:
    source = recording([0, 10, 20])
    with closing(Peeked(FreshFrames(RealtimeSource(source), max_latency_s=60))) as frames:
        time.sleep(0.2)
        assert source.read == 1
        assert [frame.index for frame in frames] == [0, 1, 2]


def test_a_camera_does_not_wait_and_its_frames_do_not_age() -> None:
    """While the consumer prepares with the first frame, nothing counts as dropped."""
    camera = Camera(1000)
    with closing(Peeked(fresh := FreshFrames(camera, prepares=True))) as frames:
        time.sleep(60 * PERIOD_S)
        assert camera.given > 20
        assert fresh.dropped == 0
        first, second = islice(frames, 2)
        assert first is frames.first
        assert second.index > 15
        assert time.perf_counter() - second.read_s < 0.2


def test_the_oldest_are_dropped_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    camera = Camera(200)
    frontend = LineFrontend(AirLine(edges=SlowEdges()))
    frontend.warm_up(pictures(1)[0])
    with closing(FreshFrames(camera)) as fresh:
        results = list(frontend.results(fresh))
    indices = [result.frame.index for result in results]
    assert indices == sorted(set(indices))
    assert indices[-1] == 199, "the newest frame is never dropped"
    assert len(results) + fresh.dropped == camera.given == 200, "those count, too, that come before the second result"
    assert fresh.dropped > 100
    assert max(result.latency_ms for result in results) < 1e3 * 200 * PERIOD_S, "it does not add up to five times that"
    warnings = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert warnings == ["camera-7: frames come faster than they are processed: dropping the oldest"]
    assert camera.closed


def test_a_frame_that_has_waited_too_long_is_dropped() -> None:
    with closing(FreshFrames(Camera(4), max_latency_s=0.5)) as fresh:
        frames = iter(fresh)
        assert [next(frames).index, next(frames).index] == [0, 1]
        time.sleep(1)  # the two others are in by now, and there is room for both
        assert list(frames) == []
        assert fresh.dropped == 2


def test_an_error_of_a_live_source_comes_behind_its_frames() -> None:
    fresh = FreshFrames(Camera(2, InputError("the cable is out")), max_latency_s=60)
    found = []
    with pytest.raises(InputError, match="cable") as caught:
        found.extend(LineFrontend(AirLine(edges=SlowEdges())).results(fresh))
    assert [result.frame.index for result in found] == [0, 1]
    assert caught.traceback[-1].name == "__iter__"
    fresh.close()


def test_a_closed_live_source_ends() -> None:
    """Before anybody has asked, while somebody waits for a frame, and while the recording waits for its next one."""
    FreshFrames(Camera(1)).close()
    camera, waiting = Camera(1000), recording([0, 0, HOUR_MS])
    frontend = LineFrontend(AirLine(edges=CannyEdges()))
    frontend.warm_up(pictures(1)[0])  # closing waits for what runs, which must not be a compiler
    for source in (FreshFrames(camera), FreshFrames(RealtimeSource(waiting))):
        results = frontend.results(source)
        assert next(results).frame.index == 0
        begin = time.monotonic()
        results.close()
        source.close()
        assert time.monotonic() - begin < 5
    assert camera.given < 200
    assert waiting.closed


def test_a_program_that_leaves_a_live_source_open_ends() -> None:
    code = """
from airline import AirLine
from frontend import LineFrontend
from frontend.sources.pace import FreshFrames
from tests.helpers.live_camera import Camera, SlowEdges
results = LineFrontend(AirLine(edges=SlowEdges())).results(FreshFrames(Camera(3000)))
assert next(results).frame.index == 0
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=60, capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (0, done.stderr.count("dropping")), "a warning at most"

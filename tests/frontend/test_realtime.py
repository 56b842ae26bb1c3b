"""A recording played at its own pace: when its frames come, what is dropped, and that it can be stopped."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from frontend.cli.settings import load
from frontend.cli.wiring import open_input
from frontend.frame import Frame
from frontend.protocols import Source, is_live
from frontend.sources.fresh import FreshFrames
from frontend.sources.realtime import RealtimeSource
from tests.helpers.command import command

STAMPS_MS = [100, 140, 150, 400, 410]  # since when does not matter


class Recording:
    """Tiny frames with given stamps, each of which takes `cost_s` to read."""

    name = "recording"
    skipped = 0

    def __init__(self, stamps_ms: list[int], cost_s: float = 0.0) -> None:
        self.stamps_ms, self.cost_s = stamps_ms, cost_s
        self.frame_count = len(stamps_ms)
        self.given = 0
        self.closed = False

    def __iter__(self):
        for index, stamp in enumerate(self.stamps_ms):
            time.sleep(self.cost_s)
            self.given += 1
            yield Frame(index, stamp * 10**6, np.zeros((16, 16), np.uint8))

    def close(self) -> None:
        self.closed = True


def arrivals_ms(source: Source, prepare_s: float = 0.0) -> list[float]:
    """When each frame came, since the second one was asked for."""
    frames = iter(source)
    next(frames)
    time.sleep(prepare_s)
    begin = time.perf_counter()
    return [1e3 * (time.perf_counter() - begin) for _ in frames]


@pytest.mark.parametrize("prepare_s", [0.0, 0.3])
def test_frames_come_when_they_are_due(prepare_s: float) -> None:
    found = arrivals_ms(RealtimeSource(Recording(STAMPS_MS)), prepare_s)
    late = np.subtract(found, np.subtract(STAMPS_MS[1:], STAMPS_MS[0]))
    assert late.min() > -1, "never early"
    assert np.median(late) < 20


def test_a_source_slower_than_its_stamps_is_read_ahead() -> None:
    slow = Recording(STAMPS_MS, cost_s=0.15)
    assert arrivals_ms(RealtimeSource(Recording(STAMPS_MS, cost_s=0.15)))[-1] > 550
    assert arrivals_ms(RealtimeSource(slow, ahead=True))[-1] < 500


def test_it_is_a_live_source_that_says_what_the_recording_says() -> None:
    recording = Recording(STAMPS_MS)
    source = RealtimeSource(recording)
    assert is_live(source)
    assert (source.name, source.frame_count, source.skipped) == ("recording", 5, 0)
    source.close()
    assert recording.closed
    assert list(RealtimeSource(Recording([]))) == []


@pytest.mark.parametrize("ahead", [False, True])
def test_closing_ends_a_wait(ahead: bool) -> None:
    source = RealtimeSource(Recording([0, 3_600_000], cost_s=0.01), ahead=ahead)
    frames = iter(source)
    next(frames)
    threading.Timer(0.2, source.close).start()
    begin = time.monotonic()
    assert next(frames, None) is None
    assert time.monotonic() - begin < 5


def test_closing_ends_reading_ahead() -> None:
    recording = Recording(list(range(100_000)), cost_s=0.01)
    source = RealtimeSource(recording, ahead=True)
    threading.Timer(0.2, source.close).start()
    assert len(list(source)) < 1000


def test_a_held_source_is_asked_for_one_frame_until_everything_is_ready() -> None:
    recording = Recording([0, 10, 20])
    fresh = FreshFrames(RealtimeSource(recording), max_latency_s=60, hold=True)
    frames = iter(fresh)
    assert next(frames).index == 0
    time.sleep(0.2)
    assert recording.given == 1
    fresh.restart()
    assert [frame.index for frame in frames] == [1, 2]
    fresh.close()


@pytest.mark.parametrize("hold", [False, True])
def test_closing_waits_for_no_frame_to_come(hold: bool) -> None:
    recording = Recording([0, 3_600_000])
    fresh = FreshFrames(RealtimeSource(recording), hold=hold)
    assert next(iter(fresh)).index == 0
    time.sleep(0.1)
    begin = time.monotonic()
    fresh.close()
    assert time.monotonic() - begin < 5
    assert recording.closed


def test_the_flag_paces_the_input_once(clip: Path) -> None:
    source = open_input(str(clip), load(None, {"input": {"realtime": True, "max_frames": 3}}))
    assert isinstance(source, RealtimeSource)
    assert source.frame_count == 3


def test_a_run_at_its_own_pace_takes_as_long_as_the_recording(clip: Path, tmp_path: Path) -> None:
    flags = ("--realtime", "--fps", 4, "--headless", "--save", tmp_path / "run.rrd", "--summary", tmp_path / "run.json")
    assert command(clip, *flags).code == 0
    figures = json.loads((tmp_path / "run.json").read_text())
    assert (figures["frames"], figures["dropped_frames"]) == (8, 0)
    assert figures["fps"] < 4 * 8 / 7 + 0.1

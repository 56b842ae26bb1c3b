"""The frontend whose stages overlap: the same results, live sources that fall behind, errors and early ends."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from airline import AirLine, CannyEdges, InputError
from airline.image import Gray
from airline.scenes import RenderedClip
from frontend import Frame, LineFrontend
from frontend.camera.undistort import with_camera
from frontend.cli.settings import RunConfig, load
from frontend.protocols import FrameResult, is_live
from frontend.run import process
from frontend.sources.fresh import FreshFrames
from frontend.sources.scene import SceneSource
from frontend.sources.selection import select_frames
from frontend.stages import WAITING
from frontend.tracks import LineTracks
from tests.helpers.command import ROOT, command
from tests.helpers.made_tracks import CAMERA, assert_all_same

CLIP = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=12, size=(320, 240))
PERIOD_S = 0.005


@pytest.fixture(autouse=True)
def no_thread_stays() -> Iterator[None]:
    def running() -> list[str]:
        return [thread.name for thread in threading.enumerate() if thread.name.startswith(("stage", "live source"))]

    assert running() == []
    yield
    assert running() == []


def pictures(count: int) -> list[NDArray[np.uint8]]:
    """A bright rectangle that moves."""
    images = []
    for number in range(count):
        image = np.full((120, 160), 60, np.uint8)
        cv2.rectangle(image, (20 + number % 40, 30), (90 + number % 40, 90), 200, -1)
        images.append(image)
    return images


class Camera:
    """Frames that come whether or not somebody takes them; asked late, it has already lost some."""

    name = "camera-7"
    frame_count = None
    skipped = 0
    live = True

    def __init__(self, count: int, error: BaseException | None = None) -> None:
        self.given = 0
        self.closed = False
        self._count, self._error = count, error

    def __iter__(self) -> Iterator[Frame]:
        for number, image in enumerate(pictures(self._count)):
            time.sleep(PERIOD_S)
            self.given += 1
            yield Frame(number, round(1e9 * PERIOD_S * number), image)
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        self.closed = True


class SlowEdges(CannyEdges):
    """Six times slower than the camera."""

    def detect(self, gray: Gray) -> NDArray[np.float32]:
        time.sleep(6 * PERIOD_S)
        return super().detect(gray)


def slow_frontend() -> LineFrontend:
    return LineFrontend(AirLine(edges=SlowEdges()))


@pytest.mark.parametrize("size", [(320, 240), (321, 243)])
def test_results_are_those_of_the_serial_run_bit_by_bit(size: tuple[int, int]) -> None:
    clip = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=25, size=size)
    frames = list(SceneSource(clip))
    detector = AirLine()

    class Stored(SceneSource):
        def __iter__(self) -> Iterator[Frame]:
            return iter(frames)

    one_by_one = [frontend.process(frame) for frontend in [LineFrontend(detector)] for frame in frames]
    serial = list(LineFrontend(detector).results(Stored(clip), serial=True))
    overlapped = list(LineFrontend(detector).results(Stored(clip)))
    assert sum(len(result.tracks) for result in serial) > 1000
    for results in (one_by_one, overlapped):
        assert_all_same([result.tracks for result in results], [result.tracks for result in serial])
        for found, expected in zip(results, serial, strict=True):
            assert found.frame is expected.frame
            for name in ("edges", "pixels", "descriptors", "labels"):
                np.testing.assert_array_equal(getattr(found.trace, name), getattr(expected.trace, name))
            np.testing.assert_array_equal(found.trace.lines.segments, expected.trace.lines.segments)
            assert found.stage_ms.keys() == expected.stage_ms.keys()
            assert found.latency_ms >= sum(found.stage_ms.values()) * 0.99
    assert_all_same(list(LineFrontend(detector).stream(Stored(clip))), [result.tracks for result in serial])


def test_files_never_drop_frames() -> None:
    tracks = list(slow_frontend().stream(SceneSource(CLIP)))
    assert [t.frame_index for t in tracks] == list(range(12))


def test_a_live_source_drops_the_oldest_when_the_detector_is_slow(caplog: pytest.LogCaptureFixture) -> None:
    camera = Camera(200)
    fresh = FreshFrames(camera)
    results = list(slow_frontend().results(fresh))
    indices = [result.frame.index for result in results]
    assert indices == sorted(set(indices))
    assert indices[-1] == 199, "the newest frame is never dropped"
    assert len(results) + fresh.dropped == camera.given == 200
    assert fresh.dropped > 100
    assert max(result.latency_ms for result in results) < 1e3 * 200 * PERIOD_S, "it does not add up to five times that"
    warnings = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert warnings == ["camera-7: frames come faster than they are processed: dropping the oldest"]
    fresh.close()
    assert camera.closed


def test_a_frame_that_has_waited_too_long_is_dropped() -> None:
    fresh = FreshFrames(Camera(3), max_latency_s=0.5)
    frames = iter(fresh)
    assert next(frames).index == 0
    time.sleep(1)  # the two others are in by now, and there is room for both
    assert list(frames) == []
    assert fresh.dropped == 2
    fresh.close()


def test_a_fast_enough_detector_drops_nothing(caplog: pytest.LogCaptureFixture) -> None:
    fresh = FreshFrames(Camera(20), max_latency_s=60)
    assert [frame.index for frame in fresh] == list(range(20))
    assert fresh.dropped == 0
    assert not caplog.records
    fresh.close()


def test_an_error_of_a_live_source_comes_behind_its_frames() -> None:
    found: list[FrameResult] = []
    fresh = FreshFrames(Camera(2, InputError("the cable is out")), max_latency_s=60)
    with pytest.raises(InputError, match="cable") as caught:
        found.extend(slow_frontend().results(fresh))
    assert [result.frame.index for result in found] == [0, 1]
    assert caught.traceback[-1].name == "__iter__"
    fresh.close()


def test_a_closed_live_source_ends() -> None:
    """Also while somebody waits for a frame, and before anybody has."""
    FreshFrames(Camera(1)).close()
    camera = Camera(1000)
    frontend = slow_frontend()
    frontend.warm_up(pictures(1)[0])  # closing waits for what runs, which must not be a compiler
    results = frontend.results(fresh := FreshFrames(camera))
    assert next(results).frame.index == 0
    results.close()
    fresh.close()
    assert camera.given < 100


def test_a_program_that_leaves_a_live_source_open_ends() -> None:
    code = """
from frontend.sources.fresh import FreshFrames
from tests.frontend.test_pipelined import Camera, slow_frontend
results = slow_frontend().results(FreshFrames(Camera(3000)))
assert next(results).frame.index == 0
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=60, capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (0, done.stderr.count("dropping")), "a warning at most"


def test_live_is_passed_on() -> None:
    assert is_live(select_frames(with_camera(Camera(1), CAMERA), stride=2))
    assert not is_live(select_frames(with_camera(SceneSource(CLIP), CAMERA), stride=2))


def test_a_fault_of_a_stage_comes_behind_the_frames_before_it() -> None:
    class Broken(CannyEdges):
        calls = 0

        def detect(self, gray: Gray) -> NDArray[np.float32]:
            self.calls += 1
            if self.calls == 6:
                raise ZeroDivisionError("in the sixth frame")
            return super().detect(gray)

    class Watched(SceneSource):
        closed = False

        def close(self) -> None:
            self.closed = True

    source = Watched(CLIP)
    found: list[LineTracks] = []
    with pytest.raises(ZeroDivisionError, match="sixth") as caught:
        found.extend(LineFrontend(AirLine(edges=Broken())).stream(source))
    assert [tracks.frame_index for tracks in found] == [0, 1, 2, 3, 4]
    assert (caught.traceback[-1].name, Path(caught.traceback[-1].path)) == ("detect", Path(__file__))
    assert source.closed


def test_a_slow_consumer_holds_up_the_file() -> None:
    read = 0

    class Counted(SceneSource):
        def __iter__(self) -> Iterator[Frame]:
            nonlocal read
            for number, image in enumerate(pictures(40)):
                read += 1
                yield Frame(number, number * 33_000_000, image)

    for tracks in LineFrontend(AirLine(edges=CannyEdges())).stream(Counted(CLIP)):
        time.sleep(0.01)
        assert read - tracks.frame_index <= 4 + WAITING


class SlowSink:
    """Keeps what it gets, slowly, and notes from which thread."""

    def __init__(self) -> None:
        self.frames: list[int] = []
        self.threads: set[int] = set()
        self.closed = 0

    def write(self, result: FrameResult) -> None:
        time.sleep(4 * PERIOD_S)
        self.frames.append(result.frame.index)
        self.threads.add(threading.get_ident())

    def close(self) -> None:
        self.closed += 1


def canny(serial: bool = False) -> RunConfig:
    edges = {"edges": {"detector": "canny", "thin": False}}
    return load(None, {"detector": edges, "serial": serial, "input": {"max_latency": 0.5}})


@pytest.mark.parametrize("serial", [False, True])
def test_a_run_counts_what_a_live_source_dropped(serial: bool, caplog: pytest.LogCaptureFixture) -> None:
    camera, sink = Camera(100), SlowSink()
    code, summary = process(camera, canny(serial), lambda: [sink])
    assert code == 0
    assert (sink.closed, sink.threads) == (1, {threading.get_ident()})
    assert summary.frames == len(sink.frames)
    assert sink.frames == sorted(set(sink.frames))
    if serial:
        assert (summary.frames, summary.dropped_frames) == (100, 0)
        return
    assert summary.dropped_frames > 20
    assert summary.frames + summary.dropped_frames <= 100  # what came while everything was loaded is not counted
    assert caplog.text.count("dropping the oldest") == 1
    assert summary.to_dict()["dropped_frames"] == summary.dropped_frames
    assert 0 < summary.latency_ms < 1000


def test_a_run_in_series_gives_the_same_tracks(clip: Path, tmp_path: Path) -> None:
    for name, flags in {"a": [], "b": ["--serial", "--max-latency", "1e-9"]}.items():
        outcome = command(
            clip, "--headless", "--out", tmp_path / f"{name}.csv", "--summary", tmp_path / f"{name}.json", *flags
        )
        assert (outcome.code, outcome.err) == (0, "")
        assert "latency, median ms" in outcome.out
    figures = [json.loads((tmp_path / f"{name}.json").read_text()) for name in "ab"]
    assert [f["frames"] for f in figures] == [8, 8]
    assert [f["dropped_frames"] for f in figures] == [0, 0]
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()

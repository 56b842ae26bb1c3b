"""The pipeline, whose stages overlap: what users of the library call, the same results, errors and early ends."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from airline import AirLine, CannyEdges, InputError
from airline.image import Gray
from airline.scenes import RenderedClip
from frontend import Frame, LineFrontend
from frontend.cli.settings import load
from frontend.protocols import FrameResult
from frontend.run import process
from frontend.sources.pace import FreshFrames
from frontend.sources.scene import SceneSource
from frontend.tracks import LineTracks
from tests.helpers.command import command
from tests.helpers.live_camera import PERIOD_S, Camera, pictures
from tests.helpers.made_tracks import assert_all_same
from tests.helpers.sources import Listed


@pytest.fixture(autouse=True)
def no_thread_stays() -> Iterator[None]:
    def running() -> list[str]:
        return [thread.name for thread in threading.enumerate() if thread.name.startswith(("stage", "live source"))]

    assert running() == []
    yield
    assert running() == []


@cache
def rendered() -> RenderedClip:
    return RenderedClip(kind="indoor", motion="handheld", seed=12, frames=12, size=(320, 240))


def drawn(count: int) -> list[Frame]:
    return [Frame(number, number * 33_000_000, image) for number, image in enumerate(pictures(count))]


def canny_frontend() -> LineFrontend:
    return LineFrontend(AirLine(edges=CannyEdges()))


def test_streams_a_source_with_its_camera() -> None:
    tracks = list(LineFrontend().stream(SceneSource(rendered())))
    assert [t.frame_index for t in tracks] == list(range(12))
    assert [t.stamp_ns for t in tracks] == [view.stamp_ns for view in rendered()]
    last, K = tracks[-1], rendered().K
    assert last.confirmed.sum() > 20
    expected = (last.segments_px - K[:2, 2]) / np.array([K[0, 0], K[1, 1]])
    assert np.allclose(last.segments_normalized, expected, atol=1e-5)


def test_detections_agree_with_the_scenes_truth() -> None:
    """Most of the rendered line length is detected, and most of what is detected is a rendered line."""
    view = RenderedClip(kind="indoor", motion="handheld", seed=3, frames=10).render(5)
    result = LineFrontend().process(Frame(0, 0, view.image))

    def away_from(segments: NDArray[np.float32]) -> NDArray[np.float32]:
        canvas = np.full(view.image.shape[:2], 255, np.uint8)
        cv2.polylines(canvas, np.rint(segments * 16).astype(int), False, 0, 1, cv2.LINE_8, 4)
        return cv2.distanceTransform(canvas, cv2.DIST_L2, 5)

    found, truth = away_from(result.trace.lines.segments), away_from(view.segments_px)
    assert (found[truth == 0] <= 2).mean() > 0.8
    assert (truth[found == 0] <= 2).mean() > 0.7


def test_streams_a_path(tmp_path: Path) -> None:
    for view in rendered().render(0), rendered().render(1):
        cv2.imwrite(str(tmp_path / f"{view.stamp_ns}.png"), view.image)
    tracks = list(LineFrontend().stream(tmp_path))
    assert len(tracks) == 2
    assert tracks[0].segments_normalized is None, "no camera, no normalised coordinates"
    with pytest.raises(InputError):
        next(LineFrontend().stream(tmp_path / "missing.mp4"))


def test_closes_the_source_when_the_user_stops_early() -> None:
    source = Listed(drawn(12))
    for _ in canny_frontend().stream(source):
        break
    assert source.closed


@pytest.mark.parametrize("size", [(320, 240), (321, 243)])
def test_results_are_those_of_the_serial_run_bit_by_bit(size: tuple[int, int]) -> None:
    source = Listed(list(SceneSource(RenderedClip(kind="indoor", motion="handheld", seed=12, frames=25, size=size))))
    detector = AirLine()
    one_by_one = [frontend.process(frame) for frontend in [LineFrontend(detector)] for frame in source]
    serial = list(LineFrontend(detector).results(source, serial=True))
    overlapped = list(LineFrontend(detector).results(source))
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
    assert_all_same(list(LineFrontend(detector).stream(source)), [result.tracks for result in serial])


def test_a_fault_of_a_stage_comes_behind_the_frames_before_it() -> None:
    class Broken(CannyEdges):
        calls = 0

        def detect(self, gray: Gray) -> NDArray[np.float32]:
            self.calls += 1
            if self.calls == 6:
                raise ZeroDivisionError("in the sixth frame")
            return super().detect(gray)

    source = Listed(drawn(12))
    found: list[LineTracks] = []
    with pytest.raises(ZeroDivisionError, match="sixth") as caught:
        found.extend(LineFrontend(AirLine(edges=Broken())).stream(source))
    assert [tracks.frame_index for tracks in found] == [0, 1, 2, 3, 4]
    assert (caught.traceback[-1].name, Path(caught.traceback[-1].path)) == ("detect", Path(__file__))
    assert source.closed


def test_warm_up_leaves_no_trace() -> None:
    cold, warm = LineFrontend(), LineFrontend()
    views = [rendered().render(i) for i in range(3)]
    warm.warm_up(views[0].image)
    frames = [Frame(index, view.stamp_ns, view.image) for index, view in enumerate(views)]
    assert_all_same([cold.process(frame).tracks for frame in frames], [warm.process(frame).tracks for frame in frames])


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


@pytest.mark.parametrize("serial", [False, True])
def test_a_run_counts_what_a_live_source_dropped(serial: bool, caplog: pytest.LogCaptureFixture) -> None:
    camera, sink = Camera(100), SlowSink()
    config = load(None, {"detector": {"edges": {"detector": "canny", "thin": False}}, "serial": serial})
    code, summary = process(camera if serial else FreshFrames(camera, 0.5), config, [sink])
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
    assert 0 < summary.latency_ms < 1000


def test_a_sink_that_cannot_be_opened_closes_those_before_it() -> None:
    first = SlowSink()

    def sinks() -> Iterator[SlowSink]:
        yield first
        raise InputError("the second one exists")

    source = Listed(drawn(3))
    with pytest.raises(InputError, match="second"):
        process(source, load(None, {"preset": "paper"}), sinks())
    assert (first.frames, first.closed, source.closed) == ([], 1, 1)


def test_runs_in_series_and_at_a_recordings_pace_give_the_same_tracks(clip: Path, tmp_path: Path) -> None:
    every = {"a": [], "b": ["--serial", "--max-latency", "1e-9"], "c": ["--realtime", "--max-latency", "60"]}
    for name, flags in every.items():
        outputs = ["--headless", "--out", tmp_path / f"{name}.csv", "--summary", tmp_path / f"{name}.json"]
        outcome = command(clip, "--fps", 4, *outputs, *flags)
        assert (outcome.code, outcome.err) == (0, "")
        figures = json.loads((tmp_path / f"{name}.json").read_text())
        assert (figures["frames"], figures["dropped_frames"]) == (8, 0)
        assert (tmp_path / f"{name}.csv").read_bytes() == (tmp_path / "a.csv").read_bytes()
    assert figures["fps"] < 4 * 8 / 7 + 0.1, "it takes as long as the recording"

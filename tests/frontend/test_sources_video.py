"""Video files: whole, cut, damaged, and things that are no video."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from functools import partial
from http.server import HTTPServer, SimpleHTTPRequestHandler
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from airline.errors import InputError
from frontend.protocols import Source
from frontend.sources import open_source
from frontend.sources.folder import FolderSource
from frontend.sources.live import LiveSource
from frontend.sources.video import VideoSource
from frontend.sources.wrapped import SelectedFrames
from tests.helpers.command import ROOT
from tests.helpers.videos import write_video

COUNT, FPS, PERIOD_NS = 60, 25, 40_000_000
KINDS = {"mjpg.avi": "MJPG", "mpeg4.mp4": "mp4v", "mpeg4.avi": "mp4v", "mjpg.mkv": "MJPG"}


def drawn(number: int) -> np.ndarray:
    """A textured picture, so that every frame has its share of bytes, with a bar that tells its number."""
    texture = np.random.default_rng(0).integers(0, 200, (24, 32, 3), np.uint8)
    image = cv2.resize(texture, (256, 120), interpolation=cv2.INTER_CUBIC)
    cv2.rectangle(image, (0, 50), (4 * number, 70), (255, 255, 255), -1)
    return image


def number_in(image: np.ndarray) -> int:
    """The number that `drawn` drew."""
    return round(np.count_nonzero(image[60].min(axis=1) > 215) / 4)


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("videos")
    for name, codec in KINDS.items():
        write_video(folder / name, map(drawn, range(COUNT)), codec, FPS)
    return folder


def write_varying_rate(path: Path, ticks: list[int]) -> None:
    """A Motion JPEG file whose frames come at the given multiples of 40 ms."""
    raw = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"MJPG"), FPS, (256, 120), raw)
    assert writer.isOpened()
    for number, tick in enumerate(ticks):
        writer.set(cv2.VIDEOWRITER_PROP_PTS, tick)
        writer.set(cv2.VIDEOWRITER_PROP_KEY_FLAG, 1)
        writer.write(cv2.imencode(".jpg", drawn(number))[1].reshape(1, -1))
    writer.release()


def stamps(source: Source) -> list[int]:
    return [frame.stamp_ns for frame in source]


@pytest.mark.parametrize("name", KINDS)
def test_whole_file(videos: Path, name: str) -> None:
    source = VideoSource(videos / name)
    assert source.frame_count == COUNT
    frames = list(source)
    source.close()
    source.close()
    assert [frame.index for frame in frames] == list(range(COUNT))
    assert [frame.stamp_ns for frame in frames] == [number * PERIOD_NS for number in range(COUNT)]
    assert [number_in(frame.image) for frame in frames[1:]] == list(range(1, COUNT))
    assert all(frame.image.flags.c_contiguous and frame.image.shape == (120, 256, 3) for frame in frames)
    assert source.skipped == 0


@pytest.mark.parametrize("percent", range(0, 100, 10))
@pytest.mark.parametrize("name", KINDS)
def test_cut_file_yields_a_prefix(videos: Path, tmp_path: Path, name: str, percent: int) -> None:
    data = (videos / name).read_bytes()
    cut = tmp_path / name
    cut.write_bytes(data[: len(data) * percent // 100])
    try:
        source = VideoSource(cut)
    except InputError:
        assert name.endswith(".mp4") or percent == 0  # an mp4 has its index at the end
    else:
        frames = list(source)
        assert [frame.stamp_ns for frame in frames] == [number * PERIOD_NS for number in range(len(frames))]
        assert 1 <= len(frames) < COUNT
        if name.startswith("mjpg"):  # whose frames are all of about the same size
            assert len(frames) == pytest.approx(COUNT * percent / 100, abs=2)
        assert source.skipped == COUNT - len(frames)
        # The last frame of a cut file may be half a frame.
        for frame, whole in zip(frames[:-1], VideoSource(videos / name), strict=False):
            np.testing.assert_array_equal(frame.image, whole.image)


def test_damage_in_the_middle_of_an_mp4(videos: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = bytearray((videos / "mpeg4.mp4").read_bytes())
    data[int(0.4 * len(data)) : int(0.6 * len(data))] = bytes(int(0.6 * len(data)) - int(0.4 * len(data)))
    (tmp_path / "damaged.mp4").write_bytes(data)
    source = VideoSource(tmp_path / "damaged.mp4")
    frames = list(source)
    assert source.skipped >= 5
    assert len(frames) + source.skipped == COUNT
    assert frames[-1].index == COUNT - 1  # frames behind the damage are read and keep their number
    assert all(frame.stamp_ns == frame.index * PERIOD_NS for frame in frames)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert f"skipped {source.skipped} frames" in caplog.text


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("start_s", [0.0, 0.01, 0.04, 0.5, 1.0, 1.01, 2.36, 2.37, 50.0])
def test_seek_is_exact(videos: Path, name: str, start_s: float) -> None:
    expected = [number for number in range(COUNT) if number * PERIOD_NS >= start_s * 1e9]
    frames = list(SelectedFrames(open_source(videos / name), start_s=start_s))
    assert [frame.index for frame in frames] == expected
    assert [number_in(frame.image) for frame in frames if frame.index] == [number for number in expected if number]


@pytest.mark.parametrize("suffix", ["mkv", "mp4"])
def test_varying_rate(tmp_path: Path, suffix: str) -> None:
    ticks = [0, 1, 2, 3, 10, 11, 12, 13, 14, 40, 41, 42, 43, 44, 45, 46, 47, 48, 49, 50]
    path = tmp_path / f"varying.{suffix}"
    write_varying_rate(path, ticks)
    source = VideoSource(path)
    assert stamps(source) == [tick * PERIOD_NS for tick in ticks]
    assert source.skipped == 0
    for start_s in (0.01, 0.16, 0.4, 0.41, 1.6, 1.9, 2.0, 3.0):
        later = VideoSource(path)
        later.seek(start_s)
        assert stamps(later) == [tick * PERIOD_NS for tick in ticks if tick * 0.04 >= start_s]


def test_ffmpeg_says_nothing(videos: Path, tmp_path: Path) -> None:
    (tmp_path / "empty.mp4").write_bytes(b"")
    data = (videos / "mpeg4.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(data[:9000])
    (tmp_path / "damaged.mp4").write_bytes(data[:9000] + bytes(9000) + data[18000:])
    script = """
import sys
from airline.errors import InputError
from frontend.sources import open_source
from frontend.sources.wrapped import SelectedFrames
for path in sys.argv[1:]:
    try:
        print(len(list(open_source(path))))
    except InputError:
        print("error")
"""
    paths = [str(tmp_path / name) for name in ("empty.mp4", "cut.mp4", "damaged.mp4")]
    # A process of its own: FFmpeg's level is set once, and this one has written videos.
    done = subprocess.run([sys.executable, "-c", script, *paths], cwd=ROOT, capture_output=True, text=True, check=True)
    counts = done.stdout.split()
    assert counts[:2] == ["error", "error"]
    assert 0 < int(counts[2]) <= COUNT
    chatter = [line for line in done.stderr.splitlines() if "skipped" not in line]
    assert chatter == []


def test_missing_file_folder_and_impossible_names(tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").mkdir()
    with pytest.raises(InputError, match="folder"):
        VideoSource(tmp_path / "clip.mp4")
    for spec in ("nowhere.mp4", "x" * 5000, "nul\0byte", "\udcff.mp4", "", "/dev/null"):
        with pytest.raises(InputError):
            open_source(spec)


def test_a_name_that_is_not_utf8_is_refused(videos: Path, tmp_path: Path) -> None:
    path = tmp_path / "clip\udcff.avi"
    try:
        path.write_bytes((videos / "mjpg.avi").read_bytes())
    except (OSError, UnicodeEncodeError):
        pytest.skip("this file system holds UTF-8 names only")
    with pytest.raises(InputError, match="UTF-8"):
        VideoSource(path)


def test_open_source_prefers_what_exists(videos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    data = (videos / "mjpg.avi").read_bytes()
    for name in ("0", "a[1]*.avi"):
        (tmp_path / name).write_bytes(data)
        assert isinstance(open_source(name), VideoSource)
    (tmp_path / "1").mkdir()
    cv2.imwrite(str(tmp_path / "1" / "0.png"), drawn(0))
    for spec in ("1", "1/*.png", "1/0.png"):
        assert isinstance(open_source(spec), FolderSource)
    with pytest.raises(InputError, match=r"logs\.open_images"):
        open_source("drive.mcap")


def test_no_such_camera_or_stream_fails_fast() -> None:
    for spec in ("99", "9" * 30, "http://127.0.0.1:9/x.mp4", "nonsense://x", "http://\udcff"):
        with pytest.raises(InputError, match="cannot open"):
            open_source(spec)
    with pytest.raises(InputError) as caught:
        open_source("rtsp://user:secret@127.0.0.1:9/x")
    assert "secret" not in str(caught.value)


def test_http_stream(videos: Path) -> None:
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Keep the test's output clean."""

    with HTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(videos))) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        before = time.time_ns()
        source = open_source(f"http://127.0.0.1:{server.server_port}/mjpg.avi")
        assert isinstance(source, LiveSource)
        assert source.frame_count is None
        assert not source.live, "a recording waits for who reads it"
        assert source.name == f"127.0.0.1-{server.server_port}-mjpg.avi"  # can name a file
        frames = list(source)
        source.close()
        server.shutdown()
        thread.join()
    assert len(frames) == COUNT
    times = [frame.stamp_ns for frame in frames]
    assert before <= times[0] <= times[-1] <= time.time_ns() + 1_000_000
    assert all(first < second for first, second in pairwise(times))
    assert [number_in(frame.image) for frame in frames[1:]] == list(range(1, len(frames)))

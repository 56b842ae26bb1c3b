"""Video files: whole, cut, damaged, and things that are no video."""

from __future__ import annotations

import gzip
import io
import subprocess
import sys
import threading
from contextlib import suppress
from fractions import Fraction
from http.server import BaseHTTPRequestHandler, HTTPServer, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from PIL import Image

from airline.errors import InputError
from frontend.protocols import Source
from frontend.sources import open_source
from frontend.sources.folder import FolderSource
from frontend.sources.video import VideoSource
from frontend.sources.wrapped import SelectedFrames
from tests.helpers.command import ROOT
from tests.helpers.videos import drawn, encode, number_in, served, trim, write_video

COUNT, FPS, PERIOD_NS = 60, 25, 40_000_000
KINDS = {"mjpg.avi": "MJPG", "mpeg4.mp4": "mp4v", "mpeg4.avi": "mp4v", "mjpg.mkv": "MJPG"}


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


def content(source: Source) -> tuple[list[int], list[int], list[int]]:
    """Indices, stamps in ms and numbers in the pictures of all frames."""
    rows = [(frame.index, round(frame.stamp_ns / 1e6), number_in(np.atleast_3d(frame.image))) for frame in source]
    source.close()
    indices, times, numbers = (list(column) for column in zip(*rows, strict=True))
    return indices, times, numbers


def steps(first: int, end: int) -> tuple[list[int], list[int], list[int]]:
    """What `content` says of whole frames at 25/s."""
    numbers = list(range(first, end))
    return numbers, [40 * number for number in numbers], numbers


CODECS: dict[str, dict[str, Any]] = {
    "h264.mp4": {"bf": "2"},
    "h264.mkv": {"bf": "2"},
    "h264.avi": {"bf": "2"},
    "h264.flv": {"bf": "2"},
    "h264.ts": {"bf": "2"},
    "h264.h264": {"bf": "2"},
    "fragments.mp4": {"bf": "2", "container": {"movflags": "frag_keyframe+empty_moov"}},
    "hevc.mp4": {"codec": "libx265"},
    "hevc10.mkv": {"codec": "libx265", "pixels": "yuv420p10le"},
    "av1.mp4": {"codec": "libsvtav1"},
    "vp9.webm": {"codec": "libvpx-vp9"},
    "vp8.webm": {"codec": "libvpx"},
    "mpeg4.avi": {"codec": "mpeg4", "bf": "2", "q": "2"},
    "prores.mov": {"codec": "prores_ks", "pixels": "yuv422p10le"},
    "grey.mkv": {"codec": "ffv1", "pixels": "gray"},
}


@pytest.mark.parametrize("name", CODECS)
def test_codecs_and_containers(tmp_path: Path, name: str) -> None:
    path = encode(tmp_path / name, **CODECS[name])
    source = VideoSource(path)
    assert source.kind.startswith("video file (")
    assert source.codec.startswith(name[:3]) or name[:4] in ("frag", "grey", "mpeg")
    assert source.notes == []
    assert content(source) == steps(0, 40)
    assert source.skipped == 0
    later = VideoSource(path)
    later.seek(1.0)
    assert content(later) == steps(25, 40)
    assert later.skipped == 0


@pytest.mark.parametrize(
    ("codec", "pixels"),
    [
        *[("libx264", pixels) for pixels in ("yuv420p", "yuvj420p", "yuv444p", "yuv420p10le", "yuv422p")],
        *[("ffv1", pixels) for pixels in ("bgr0", "yuv420p", "gbrp16le", "yuva420p")],
        ("mpeg4", "yuv420p"),
        ("mjpeg", "yuvj422p"),
    ],
)
@pytest.mark.parametrize("matrix", [None, 1, 5])  # BT.709, BT.601
@pytest.mark.parametrize("odd", [False, True])
def test_colours_are_those_of_opencv(tmp_path: Path, codec: str, pixels: str, matrix: int | None, odd: bool) -> None:
    if odd and codec == "libx264" and pixels != "yuv444p":
        pytest.skip("has even sizes only")
    image = cv2.resize(drawn(20), (253, 119)) if odd else drawn(20)
    with av.open(str(tmp_path / "clip.mkv"), "w") as file:
        stream: Any = file.add_stream(codec, rate=25)
        stream.height, stream.width = image.shape[:2]
        stream.pix_fmt = pixels
        if matrix is not None:
            stream.codec_context.colorspace = matrix
        frame = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format=pixels, dst_colorspace=matrix)
        file.mux([*stream.encode(frame), *stream.encode()])
    capture = cv2.VideoCapture(str(tmp_path / "clip.mkv"), cv2.CAP_FFMPEG)
    expected = capture.read()[1]
    capture.release()
    (found,) = VideoSource(tmp_path / "clip.mkv")
    assert found.image.flags.c_contiguous
    assert found.image.flags.writeable
    assert np.abs(found.image.astype(int) - expected).max() <= 1


@pytest.mark.parametrize(("pixels", "bits"), [("gray", 8), ("gray16le", 16), ("gray10le", 16)])
def test_grey_video_stays_grey(tmp_path: Path, pixels: str, bits: int) -> None:
    image = np.random.default_rng(0).integers(0, 256, (119, 255), np.uint8)  # rows that FFmpeg pads
    pixel_type, scale = (np.uint8, 1) if bits == 8 else (np.uint16, 257)
    with av.open(str(tmp_path / "clip.mkv"), "w") as file:
        stream: Any = file.add_stream("ffv1", rate=25)
        stream.height, stream.width = image.shape
        stream.pix_fmt = pixels
        frame = av.VideoFrame.from_ndarray(image, format="gray").reformat(format=pixels)
        file.mux([*stream.encode(frame), *stream.encode()])
    (found,) = VideoSource(tmp_path / "clip.mkv")
    assert found.image.dtype == pixel_type
    assert found.image.flags.c_contiguous
    np.testing.assert_allclose(found.image.astype(float), image.astype(float) * scale, atol=0 if bits == 8 else 512)


@pytest.mark.parametrize("suffix", ["mp4", "mov"])
@pytest.mark.parametrize("options", [{"bf": "0"}, {"bf": "2"}, {"codec": "libx265"}])
def test_what_an_edit_list_hides_is_no_frame(tmp_path: Path, suffix: str, options: dict[str, str], caplog: Any) -> None:
    whole = encode(tmp_path / "whole.mp4", g="40", **options)
    source = VideoSource(trim(whole, tmp_path / f"cut.{suffix}", 600))
    assert source.frame_count == 25
    assert source.last_stamp_ns == 960_000_000
    assert content(source) == (*steps(0, 25)[:2], list(range(15, 40)))
    assert source.skipped == 0
    assert caplog.records == []
    later = VideoSource(tmp_path / f"cut.{suffix}")
    later.seek(0.4)
    assert content(later) == (*(row[10:] for row in steps(0, 25)[:2]), list(range(25, 40)))


def test_a_varying_rate_with_b_frames(tmp_path: Path) -> None:
    times = [40 * k if k < 20 else 47 * k for k in range(40)]
    path = encode(tmp_path / "clip.mp4", times_ms=times, bf="2", g="12")
    assert content(VideoSource(path)) == (list(range(40)), times, list(range(40)))
    later = VideoSource(path)
    later.seek(1.0)
    _, found, numbers = content(later)
    assert found == [time for time in times if time >= 1000]
    assert numbers == [k for k, time in enumerate(times) if time >= 1000]


def test_raw_video_without_times_takes_a_rate_and_says_so(tmp_path: Path) -> None:
    path = encode(tmp_path / "clip.mjpeg", "mjpeg", pixels="yuvj420p", q="2")
    source = open_source(path, fps=20)
    assert source.notes == ["the video holds no times: 20 frames/s are assumed; --fps gives another rate"]
    assert content(source) == (list(range(40)), [50 * k for k in range(40)], list(range(40)))


ROTATIONS = {
    (90, False, False): ("turned by 90 degrees counterclockwise", lambda image: np.rot90(image)),
    (-90, False, False): ("turned by 90 degrees clockwise", lambda image: np.rot90(image, -1)),
    (180, False, False): ("turned by 180 degrees", lambda image: np.rot90(image, 2)),
    (0, True, False): ("mirrored", lambda image: image[:, ::-1]),
    (0, False, True): ("mirrored upside down", lambda image: image[::-1]),
}


@pytest.mark.parametrize("rotation", ROTATIONS)
def test_pictures_are_turned_upright(tmp_path: Path, rotation: tuple[int, bool, bool]) -> None:
    words, turn = ROTATIONS[rotation]
    path = encode(tmp_path / "clip.mp4", count=3, rotation=rotation)
    plain = VideoSource(path, autorotate=False)
    assert plain.orientation.startswith("as stored")
    assert plain.notes == []
    stored = [frame.image for frame in plain]
    assert number_in(stored[2]) == 2
    source = VideoSource(path)
    assert source.orientation.startswith(words)
    (note,) = source.notes
    assert words in note
    assert "--no-autorotate" in note
    for frame, image in zip(source, stored, strict=True):
        assert frame.image.flags.c_contiguous
        np.testing.assert_array_equal(frame.image, turn(image))


@pytest.mark.parametrize("name", ["h264.mkv", "prores.mov", "av1.mp4"])
def test_frames_behind_damage_keep_number_and_time(tmp_path: Path, name: str) -> None:
    path = encode(tmp_path / name, **CODECS[name])
    data = bytearray(path.read_bytes())
    place = int(0.8 * len(data))  # far behind the first picture, which is most of the file
    data[place : place + 150] = np.random.default_rng(1).bytes(150)
    path.write_bytes(data)
    source = VideoSource(path)
    frames = list(source)
    assert source.skipped >= 1
    assert len(frames) + source.skipped == 40
    assert all(frame.stamp_ns == frame.index * PERIOD_NS for frame in frames)


def write_sound(path: Path) -> None:
    with av.open(str(path), "w") as file:
        stream: Any = file.add_stream("pcm_s16le", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        file.mux([*stream.encode(frame), *stream.encode()])


def test_what_is_no_video_is_named(tmp_path: Path) -> None:
    path = tmp_path / "x.mp4"
    write_sound(tmp_path / "x.wav")
    (tmp_path / "x.wav").rename(path)
    with pytest.raises(InputError, match="holds audio, no readable video frame"):
        VideoSource(path)
    path.write_text("no video\n" * 99)
    with pytest.raises(InputError, match=r"x\.mp4' is no video that can be read: it is text"):
        VideoSource(path)
    path.write_bytes(cv2.imencode(".png", drawn(1))[1].tobytes())
    with pytest.raises(InputError, match="is an image, no video"):
        VideoSource(path)
    path.write_bytes(encode(tmp_path / "whole.mp4").read_bytes().replace(b"avc1", b"zzzz"))
    with pytest.raises(InputError, match="of a codec that this FFmpeg cannot decode"):
        VideoSource(path)
    raw = bytearray(encode(tmp_path / "raw.avi", "rawvideo", 2, pixels="bgr24").read_bytes())
    place = raw.index(b"strf")
    raw[place + 12 : place + 20] = (60000).to_bytes(4, "little") * 2
    path.write_bytes(raw)
    with pytest.raises(InputError, match="rawvideo video, but no readable video frame"):
        VideoSource(path)


@pytest.mark.parametrize("name", ["h264.mp4", "h264.mkv", "h264.ts", "av1.mp4", "mpeg4.avi"])
def test_a_recording_behind_a_url_has_its_own_times(tmp_path: Path, name: str) -> None:
    encode(tmp_path / name, **CODECS[name])
    with served(tmp_path) as url:
        source = open_source(f"{url}/{name}")
        assert isinstance(source, VideoSource)
        assert not source.live
        assert source.kind.startswith("recording at a URL (")
        assert source.name == f"{url.removeprefix('http://').replace(':', '-')}-{name}"  # can name a file
        assert content(source) == steps(0, 40)
        later = open_source(f"{url}/{name}")
        later.seek(1.0)
        assert content(later) == steps(25, 40)
    assert content(open_source((tmp_path / name).as_uri())) == steps(0, 40)


def test_a_finished_playlist_is_a_recording(tmp_path: Path) -> None:
    whole = encode(tmp_path / "whole.mp4", bf="2", g="12")
    trim(whole, tmp_path / "clip.m3u8", 0, hls_time="0.4", hls_playlist_type="vod")
    assert len(list(tmp_path.glob("*.ts"))) > 2
    with served(tmp_path) as url:
        assert content(open_source(f"{url}/clip.m3u8")) == steps(0, 40)
    assert content(open_source(tmp_path / "clip.m3u8")) == steps(0, 40)


def test_addresses_that_lead_nowhere_are_said_without_their_password(tmp_path: Path) -> None:
    (tmp_path / "noise.mp4").write_bytes(np.random.default_rng(0).bytes(9999))
    with served(tmp_path) as url:
        for name in ("missing.mp4", "noise.mp4"):
            place = url.replace("//", "//me:secret@") + f"/{name}"
            for open_it in (open_source, VideoSource):
                with pytest.raises(InputError, match=f"cannot open.*{name}") as caught:
                    open_it(place)
                assert "secret" not in str(caught.value)
    with pytest.raises(InputError, match=r"there is no video file '/nowhere/a b\.mp4'"):
        open_source("file:///nowhere/a%20b.mp4")


def test_a_recording_that_breaks_off_is_fetched_on(tmp_path: Path) -> None:
    """By a server that sends a third of what it was asked for, and then closes."""
    data = encode(tmp_path / "clip.ts", bf="0", g="10", crf="5").read_bytes()

    class Weak(BaseHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Keep the test's output clean."""

        def do_GET(self) -> None:
            asked = self.headers.get("Range", "bytes=0-")
            begin = int(asked.removeprefix("bytes=").split("-")[0])
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {begin}-{len(data) - 1}/{len(data)}")
            self.send_header("Content-Length", str(len(data) - begin))
            self.end_headers()
            self.wfile.write(data[begin : begin + len(data) // 3])

    with HTTPServer(("127.0.0.1", 0), Weak) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            assert content(VideoSource(f"http://127.0.0.1:{server.server_port}/clip.ts")) == steps(0, 40)
        finally:
            server.shutdown()
            thread.join()


def test_closing_while_another_thread_reads(tmp_path: Path) -> None:
    path = encode(tmp_path / "clip.mp4", count=60)
    for _ in range(5):
        source = VideoSource(path)
        thread = threading.Thread(target=list, args=(source,))
        thread.start()
        source.close()
        thread.join(10)
        assert not thread.is_alive()
    assert list(VideoSource(path))[-1].index == 59


def with_exif(number: int, exif: int) -> bytes:
    """A JPEG of `drawn` as a camera writes it, with EXIF data."""
    file, data = io.BytesIO(), Image.Exif()
    data[0x010F], data[0x0112] = "a camera", exif
    Image.fromarray(drawn(number)[:, :, ::-1]).save(file, "JPEG", quality=95, exif=data)
    return file.getvalue()


@pytest.mark.parametrize("exif", [1, 2, 6, 7])
@pytest.mark.parametrize("suffix", ["avi", "mov", "mkv", "mjpeg"])
def test_jpegs_with_exif_data_are_turned_as_in_folders(tmp_path: Path, suffix: str, exif: int) -> None:
    jpegs = [with_exif(number, exif) for number in range(8)]
    path = tmp_path / f"clip.{suffix}"
    with av.open(str(path), "w") as file:
        stream: Any = file.add_stream("mjpeg", rate=25)
        stream.height, stream.width, stream.pix_fmt = 120, 256, "yuvj420p"
        for number, jpeg in enumerate(jpegs):
            packet = av.Packet(jpeg)
            packet.pts = packet.dts = number
            packet.time_base, packet.stream, packet.is_keyframe = Fraction(1, 25), stream, True
            file.mux(packet)
        file.mux([])
    (tmp_path / "one.jpg").write_bytes(jpegs[0])
    (still,) = open_source(tmp_path / "one.jpg")
    source = open_source(path, fps=25)
    frames = list(source)
    assert frames[0].image.shape == still.image.shape
    assert np.corrcoef(frames[0].image.ravel(), still.image.ravel())[0, 1] > 0.97
    assert [frame.stamp_ns for frame in frames] == [number * PERIOD_NS for number in range(8)]
    assert ("EXIF" in source.orientation) == (exif != 1)
    stored = [frame.image for frame in open_source(path, fps=25, autorotate=False)]
    assert [number_in(image) for image in stored] == list(range(8))


def transport(path: Path, begin: int, count: int = 10, jump: int = 0) -> bytes:
    """MPEG-TS at 25 frames/s from a time on, in 1/90000 s, which may jump behind the fifth picture."""
    times = [begin + 3600 * k + (jump if k >= 5 else 0) for k in range(count)]
    with av.open(str(path), "w", options={"muxdelay": "0"}) as file:
        stream: Any = file.add_stream("libx264", rate=25, options={"bf": "0"})
        stream.height, stream.width, stream.pix_fmt = 120, 256, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 90000)
        for number, pts in enumerate(times):
            frame = av.VideoFrame.from_ndarray(drawn(number), format="bgr24").reformat(format="yuv420p")
            frame.pts, frame.time_base = pts, Fraction(1, 90000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path.read_bytes()


@pytest.mark.parametrize(("first", "second", "step_s"), [(100, 5, 95.4), (5, 5, 0.36), (40, 20, 20.4)])
def test_joined_videos_go_on_where_their_clock_steps_back(
    tmp_path: Path, first: int, second: int, step_s: float
) -> None:
    path = tmp_path / "joined.ts"
    path.write_bytes(b"".join(transport(tmp_path / "part.ts", 90000 * begin) for begin in (first, second)))
    source = VideoSource(path)
    assert (source.frame_count, source.last_stamp_ns) == (20, None)
    assert content(source) == (*steps(0, 20)[:2], [*range(10), *range(10)])
    assert source.skipped == 0
    assert source.notes == [f"times step back by {step_s} s, as where videos are joined: they are taken to go on"]
    later = VideoSource(path)
    later.seek(0.2)
    assert content(later)[1:] == (steps(5, 20)[1], [*range(5, 10), *range(10)])


@pytest.mark.parametrize(("begin", "jump", "last_ms"), [(2**33 - 18000, 0, 360), (90000, 90000 * 3600, 3_600_360)])
def test_a_clock_that_wraps_around_or_jumps_ahead(tmp_path: Path, begin: int, jump: int, last_ms: int) -> None:
    transport(tmp_path / "clip.ts", begin, jump=jump)
    source = VideoSource(tmp_path / "clip.ts")
    assert (source.frame_count, source.last_stamp_ns) == (10, last_ms * 1_000_000)
    _, times, numbers = content(source)
    assert numbers == list(range(10))
    assert times == [40 * k + (jump // 90 if k >= 5 else 0) for k in range(10)]
    assert (source.skipped, source.notes) == (0, [])


@pytest.mark.parametrize("name", ["clip.mkv", "clip.webm", "clip.nut", "clip.mp4", "clip.ts", "clip.mov"])
def test_a_video_that_does_not_begin_at_zero(tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture) -> None:
    codec = "libvpx" if name.endswith("webm") else "libx264"
    path = encode(tmp_path / name, codec, times_ms=[10_000 + 40 * k for k in range(40)])
    source = VideoSource(path)
    assert source.frame_count == 40
    assert source.last_stamp_ns == pytest.approx(1_560_000_000, abs=2_000_000)
    assert content(source) == steps(0, 40)
    assert (source.skipped, caplog.records) == (0, [])


@pytest.mark.parametrize("options", [{}, {"bf": "2"}])
@pytest.mark.parametrize("suffix", ["mpg", "vob"])
def test_program_streams_are_counted(tmp_path: Path, suffix: str, options: dict[str, str]) -> None:
    source = VideoSource(encode(tmp_path / f"clip.{suffix}", "mpeg2video", 20, q="2", **options))
    assert (source.frame_count, source.last_stamp_ns) == (20, 760_000_000)
    assert content(source)[1] == steps(0, 20)[1]
    assert source.skipped == 0


def test_a_video_that_begins_between_key_frames(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = encode(tmp_path / "clip.ts", count=60, g="30", bf="0", sc_threshold="0").read_bytes()
    (tmp_path / "cut.ts").write_bytes(data[188 * 60 :])
    source = VideoSource(tmp_path / "cut.ts")
    assert source.frame_count == 30
    assert content(source)[2] == list(range(30, 60))
    assert caplog.records == []
    (note,) = source.notes
    assert note.startswith("the video begins between key frames: its first ")


class Unsized(BaseHTTPRequestHandler):
    """Serves a file without saying how long it is, and only from its begin on."""

    data: bytes

    def log_message(self, *_: object) -> None:
        """Keep the test's output clean."""

    def do_HEAD(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "video/mp4")
        self.end_headers()

    def do_GET(self) -> None:
        self.do_HEAD()
        with suppress(OSError):  # who only looks at the begin leaves
            self.wfile.write(self.data)


@pytest.mark.parametrize("name", ["clip.mp4", "clip.ts", "clip.mkv"])
def test_a_server_that_does_not_say_how_long_a_file_is(tmp_path: Path, name: str) -> None:
    options = {"container": {"movflags": "+faststart"}} if name.endswith("mp4") else {}
    Unsized.data = encode(tmp_path / name, bf="2", crf="5", **options).read_bytes()  # type: ignore[arg-type]
    with ThreadingHTTPServer(("127.0.0.1", 0), Unsized) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            source = open_source(f"http://127.0.0.1:{server.server_port}/{name}", reconnect_s=0)
            assert not source.live
            assert source.notes == [
                "the server does not say how long the file is: its name says that it is a recording"
            ]
            assert content(source) == steps(0, 40)
        finally:
            server.shutdown()
            thread.join()


def test_what_is_no_video_behind_a_url_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(900))
    (tmp_path / "b.mp4.gz").write_bytes(gzip.compress(encode(tmp_path / "b.mp4", count=3).read_bytes()))
    for name in ("c.jpg", "d.png", "e.webp"):
        cv2.imwrite(str(tmp_path / name), drawn(1))
    Image.fromarray(drawn(1)).save(tmp_path / "f.gif", save_all=True, append_images=[Image.fromarray(drawn(2))])
    saying = "only videos come from a URL: save it as a file, and name that"
    with served(tmp_path) as url:
        for name in ("a.mcap", "c.jpg", "d.png", "e.webp", "f.gif"):
            what = "a log" if name == "a.mcap" else "an image, no video"
            with pytest.raises(InputError, match=f"{name}' is {what}: {saying}"):
                open_source(f"{url}/{name}")
        with pytest.raises(InputError, match=r"b\.mp4\.gz' is packed by gzip and holds a video: unpack it into a file"):
            open_source(f"{url}/b.mp4.gz")

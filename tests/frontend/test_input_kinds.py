"""What an input is, told by its content: under any name, packed, a device, a pipe."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import signal
import subprocess
import sys
import tarfile
import threading
import time
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import zstandard
from PIL import Image

from airline.errors import InputError
from frontend.cli import wiring
from frontend.cli.info import describe
from frontend.cli.settings import RunConfig
from frontend.protocols import Source
from frontend.sources import kinds, live, open_source
from frontend.sources.live import LiveSource
from frontend.sources.video import VideoSource
from logs.files import is_log, open_log
from tests.helpers.command import ROOT, command, python, refusal
from tests.helpers.videos import drawn, encode, number_in

BAG, MCAP, SQLITE = b"#ROSBAG V2.0\n" + bytes(900), b"\x89MCAP0\r\n" + bytes(900), b"SQLite format 3\0" + bytes(900)


def jpeg(number: int, **flags: int) -> bytes:
    made = cv2.resize(drawn(number), (flags.get("width", 256), 120))
    return cv2.imencode(".jpg", made, [cv2.IMWRITE_JPEG_PROGRESSIVE, flags.get("progressive", 0)])[1].tobytes()


def zipped(name: str) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(name, b"content")
    return file.getvalue()


def tarred(name: str, mode: str) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode=mode) as archive:  # type: ignore[call-overload]
        archive.addfile(tarfile.TarInfo(name), io.BytesIO(b""))
    return file.getvalue()


PACKED = {
    "a.bag.gz": (gzip.compress(BAG), "gzip and holds a ROS 1 bag", "gunzip -c {}/a.bag.gz > {}/a.bag"),
    "b.mcap.gz": (gzip.compress(MCAP), "gzip and holds an MCAP log", "gunzip -c {}/b.mcap.gz > {}/b.mcap"),
    "c.mcap.zst": (zstandard.compress(MCAP), "zstd and holds a log", "zstd -d {}/c.mcap.zst -o {}/c.mcap"),
    "d.db3.zstd": (zstandard.compress(SQLITE), "zstd and holds a log", "zstd -d {}/d.db3.zstd -o {}/d.db3"),
    "e.bag.bz2": (bz2.compress(BAG), "bzip2 and holds a ROS 1 bag", "bunzip2 -c {}/e.bag.bz2 > {}/e.bag"),
    "f.mcap.xz": (lzma.compress(MCAP), "xz and holds an MCAP log", "xz -dc {}/f.mcap.xz > {}/f.mcap"),
    "g.bag": (gzip.compress(BAG), "gzip and holds a ROS 1 bag", "gunzip -c {}/g.bag > {}/g.bag.unpacked"),
    "h.mp4": (zstandard.compress(bytes(99)), "zstd", "zstd -d {}/h.mp4 -o {}/h.mp4.unpacked"),
    "i.zip": (zipped("cam0/000.png"), "zip and holds images", "unzip {}/i.zip -d {}/i"),
    "j.zip": (zipped("drive.bag"), "zip and holds a log", "unzip {}/j.zip -d {}/j"),
    "k.tar": (tarred("000.jpg", "w"), "tar and holds images", "tar xf {}/k.tar"),
    "l.tgz": (tarred("000.jpg", "w:gz"), "gzip and holds a tar archive", "tar xf {}/l.tgz"),
    "m.7z": (b"7z\xbc\xaf\x27\x1c" + bytes(99), "7-Zip", "7z x {}/m.7z -o{}/m"),
}


@pytest.mark.parametrize("name", PACKED)
def test_packed_inputs_are_named_with_the_command_that_unpacks_them(tmp_path: Path, name: str) -> None:
    data, what, how = PACKED[name]
    path = tmp_path / name
    path.write_bytes(data)
    says = f"is packed by {what}: unpack it first with `{how.replace('{}', str(tmp_path))}`"
    for open_it in (open_source, open_log, VideoSource, lambda spec: wiring.open_input(str(spec), RunConfig())):
        with pytest.raises(InputError) as caught:
            open_it(path)
        assert says in str(caught.value)
    assert says in refusal(path, "--info")


@pytest.mark.parametrize("content", [BAG, MCAP, SQLITE])
@pytest.mark.parametrize("name", ["recording", "drive.mp4", "drive.bag.active", "drive.png"])
def test_a_log_is_one_under_any_name(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert is_log(path)
    for open_it in (open_source, VideoSource):
        with pytest.raises(InputError, match=r"is a log: open it with logs\.open_images"):
            open_it(path)


@pytest.mark.parametrize("name", ["clip", "clip.bag", "clip.png", "clip.tar"])
def test_a_video_is_one_under_any_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(encode(tmp_path / "clip.mp4", count=5).read_bytes())
    assert not is_log(path)
    source = wiring.open_input(str(path), RunConfig())
    assert [number_in(frame.image) for frame in source] == list(range(5))
    assert source.kind == "video file (mp4)"
    source.close()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tiff", ".webp", ".pgm", ".ppm"])
def test_an_image_is_one_under_any_name(tmp_path: Path, suffix: str) -> None:
    image = drawn(1)[:, :, 0] if suffix == ".pgm" else drawn(1)
    data = cv2.imencode(suffix, image)[1].tobytes()
    for name in ("image", "image.mp4"):
        assert kinds.kind_of_content(data, Path(name).suffix) == "image"
    assert kinds.kind_of_content(b"\0\0\0\x18ftypheic" + bytes(99)) == "image"
    assert kinds.kind_of_content(b"\0\0\0\x18ftypisom" + bytes(99)) == "video"
    assert kinds.kind_of_content(b"\xff\xd8\xff\xe0", ".mjpeg") == "unknown", "one JPEG after the other"


def test_what_names_say_counts_for_what_is_missing_or_unknown(tmp_path: Path) -> None:
    (tmp_path / "noise.bag").write_bytes(np.random.default_rng(0).bytes(999))
    for path in (tmp_path / "noise.bag", tmp_path / "missing.mcap"):
        assert is_log(path)
    assert not is_log(tmp_path / "missing.mp4")


@pytest.mark.parametrize("device", ["/dev/video97", "/dev/v4l/by-id/usb-nobody_has_this_camera-index0"])
def test_a_cameras_device_is_a_camera(device: str) -> None:
    with pytest.raises(InputError, match=f"cannot open camera {device}: is it connected and free"):
        open_source(device)
    assert f"cannot open camera {device}" in refusal(device)


def test_frames_of_a_cameras_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No machine of the tests has a camera: a file stands for one."""
    clip = str(encode(tmp_path / "clip.mp4", count=5))
    opened: list[object] = []

    def camera(device: object, *_: object) -> cv2.VideoCapture:
        opened.append(device)
        return cv2.VideoCapture(clip)

    monkeypatch.setattr(live, "_open", camera)
    source = open_source("/dev/video97")
    assert isinstance(source, LiveSource)
    assert (source.live, source.kind, source.name) == (True, "live camera", "camera-dev-video97")
    frames = iter(source)
    assert [number_in(next(frames).image) for _ in range(5)] == list(range(5))
    with pytest.raises(InputError, match="camera /dev/video97 sends no more pictures: is it still connected"):
        next(frames)
    assert opened == ["/dev/video97"]


def test_devices_that_are_no_camera() -> None:
    with pytest.raises(InputError, match=r"'/dev/zero' is a device, no video file"):
        open_source("/dev/zero")
    said = subprocess.run(
        [sys.executable, "-m", "frontend.run", "-"], cwd=ROOT, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert said.returncode == 2
    assert said.stderr.startswith("error: the standard input is a device, no video file: name one, or send")


STREAMS = {
    "clip.ts": {},
    "clip.mkv": {"bf": "2"},
    "clip.h264": {"bf": "2"},
    "clip.y4m": {"codec": "wrapped_avframe"},
    "fragments.mp4": {"container": {"movflags": "frag_keyframe+empty_moov"}},
}


@pytest.mark.parametrize("name", STREAMS)
def test_a_named_pipe(tmp_path: Path, name: str) -> None:
    data = encode(tmp_path / name, **STREAMS[name]).read_bytes()  # type: ignore[arg-type]
    pipe = tmp_path / "pipe.mp4"
    os.mkfifo(pipe)
    threading.Thread(target=pipe.write_bytes, args=(data,), daemon=True).start()
    source = open_source(pipe)
    assert source.kind.startswith("video stream from a pipe (")
    assert not source.live, "it waits for who reads it"
    frames = list(source)
    source.close()
    assert [number_in(frame.image) for frame in frames] == list(range(40))
    assert [frame.stamp_ns for frame in frames] == [40_000_000 * k for k in range(40)]


def test_what_comes_through_a_pipe_is_told_too(tmp_path: Path) -> None:
    whole = encode(tmp_path / "clip.mp4", crf="5").read_bytes()  # more than FFmpeg keeps in memory
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for data, says in {
        MCAP: "is a log",
        gzip.compress(BAG): "is packed by gzip and holds a ROS 1 bag: unpack it into a file, and name that",
        jpeg(1): "is an image, no video: only videos come through a pipe: save it as a file, and name that",
        whole: "sends an MP4 whose index is at its end: name the file, or send Matroska or MPEG-TS",
        b"hello\n" * 99: "it is text",
        b"": "is empty",
    }.items():
        writer = subprocess.Popen(["sh", "-c", f"cat > {pipe}"], stdin=subprocess.PIPE)
        threading.Thread(target=writer.communicate, args=(data,), daemon=True).start()
        with pytest.raises(InputError, match=says):
            open_source(pipe)
        writer.wait(10)


def test_the_standard_input(tmp_path: Path) -> None:
    data = encode(tmp_path / "clip.ts").read_bytes()
    run = [sys.executable, "-m", "frontend.run"]
    shown = subprocess.run([*run, "-", "--info"], cwd=ROOT, input=data, capture_output=True, check=True)
    assert b"kind:        video stream from stdin (mpegts)" in shown.stdout
    out = tmp_path / "t.csv"
    subprocess.run([*run, "/dev/stdin", "--out", out], cwd=ROOT, input=data, capture_output=True, check=True)
    assert len({line.split(",")[0] for line in out.read_text().splitlines()[1:]}) == 40
    with encode(tmp_path / "clip.mp4").open("rb") as file:  # a file, with an index at its end
        shown = subprocess.run([*run, "-", "--info"], cwd=ROOT, stdin=file, capture_output=True, check=True)
    assert b"frames:      40" in shown.stdout
    refused = subprocess.run([*run, "-", "--log-image", "video"], cwd=ROOT, input=data, capture_output=True)
    assert b"--log-image video needs a video file as its input, not -" in refused.stderr


def test_ctrl_c_ends_the_wait_for_a_pipe(tmp_path: Path) -> None:
    data = encode(tmp_path / "clip.ts", count=40, crf="5").read_bytes()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    run = python(pipe, "--out", tmp_path / "t.csv", stdout=-1, stderr=-1)
    with run, pipe.open("wb") as writer:  # which stays open and sends no more
        writer.write(data)
        writer.flush()
        deadline = time.monotonic() + 60
        while not (tmp_path / "t.csv").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.5)
        run.send_signal(signal.SIGINT)
        printed, said = run.communicate(timeout=30)
    assert run.returncode == 130
    assert said == "WARNING: interrupted: what was done so far is kept\n"
    assert "wrote" in printed


def test_info_of_a_video(tmp_path: Path) -> None:
    source = wiring.open_input(str(encode(tmp_path / "clip.mp4", rotation=(-90, False, False))), RunConfig())
    lines = dict(line.split(":", 1) for line in describe(source).splitlines())
    source.close()
    rows = {name: text.strip() for name, text in lines.items()}
    assert rows["kind"] == "video file (mp4)"
    assert rows["size"] == "120x256 colour, 8 bits"
    assert rows["frames"] == "40"
    assert rows["last time"] == "1.560000000 s"
    assert rows["rate"] == "25 frames/s"
    assert rows["codec"] == "h264"
    assert rows["orientation"].startswith("turned by 90 degrees clockwise")
    assert rows["note"].startswith("images are turned by 90 degrees clockwise")


@pytest.mark.parametrize("name", ["clip", "clip.jpg", "clip.bin", "clip.mjpeg", "clip.png"])
@pytest.mark.parametrize("padding", [b"", bytes(100), b"\r\n"])
@pytest.mark.parametrize("progressive", [0, 1])
def test_jpegs_one_after_the_other_are_a_video(tmp_path: Path, name: str, padding: bytes, progressive: int) -> None:
    path = tmp_path / name
    path.write_bytes(padding.join(jpeg(number, progressive=progressive) for number in range(12)))
    for source in (open_source(path, fps=20), through_a_pipe(tmp_path, path.read_bytes(), fps=20)):
        assert source.kind.endswith("(mjpeg)")
        frames = list(source)
        source.close()
        assert [number_in(frame.image) for frame in frames] == list(range(12))
        assert [frame.stamp_ns for frame in frames] == [50_000_000 * number for number in range(12)]
        assert source.notes == ["the video holds no times: 20 frames/s are assumed; --fps gives another rate"]


def through_a_pipe(folder: Path, data: bytes, fps: float) -> Source:
    pipe = folder / "a pipe"
    pipe.unlink(missing_ok=True)
    os.mkfifo(pipe)
    threading.Thread(target=pipe.write_bytes, args=(data,), daemon=True).start()
    return open_source(pipe, fps=fps)


def test_a_still_with_something_behind_it_is_a_still(tmp_path: Path) -> None:
    pictures = [Image.fromarray(drawn(number)) for number in (7, 8, 9)]
    pictures[0].save(tmp_path / "stereo.jpg", "MPO", save_all=True, append_images=pictures[1:])
    (tmp_path / "preview.jpg").write_bytes(jpeg(7) + jpeg(8, width=128))
    (tmp_path / "motion.jpg").write_bytes(jpeg(7) + b"\0\0\0\x18ftypmp42" + bytes(5000))
    (tmp_path / "padded.jpg").write_bytes(jpeg(7) + bytes(5000))
    (tmp_path / "cut.jpg").write_bytes(jpeg(7) + b"\xff\xd8\xff")
    for path in tmp_path.glob("*.jpg"):
        source = open_source(path)
        assert source.kind == "one image", path.name
        assert [number_in(frame.image) for frame in source] == [7]


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("http://user:p@ss@host/clip.mp4", "http://host/clip.mp4"),
        ("http://user:se/cret@host/clip.mp4", "http://host/clip.mp4"),
        ("rtsp://user:se?c#ret@host:554/live", "rtsp://host:554/live"),
        ("http://user@host/clip.mp4", "http://host/clip.mp4"),
        ("http://host/clip@2x.mp4", "http://host/clip@2x.mp4"),
        ("http://host:80/video?user=me&pwd=secret", "http://host:80/video?..."),
        ("/folder/a@b.mp4", "/folder/a@b.mp4"),
    ],
)
def test_no_password_is_shown(address: str, shown: str) -> None:
    assert kinds.without_password(address) == shown


def test_file_urls_of_every_form(tmp_path: Path) -> None:
    path = encode(tmp_path / "a b#1.mp4", count=3)
    quoted = str(path).replace(" ", "%20").replace("#", "%23")
    for form in ("file://{}", "FILE://{}", "file:{}", "File://localhost{}"):
        for name in (quoted, path):
            source = open_source(form.format(name))
            assert (source.kind, len(list(source))) == ("video file (mp4)", 3)
    assert kinds.local_name("HTTP://Host/Clip.MP4") == "http://Host/Clip.MP4"


@pytest.mark.parametrize("name", ["*.mp4", "%06d.png", "0", "/dev/video97"])
def test_video_in_the_recording_needs_a_file_before_any_work(tmp_path: Path, name: str) -> None:
    said = refusal(name, "--log-image", "video", "--save", tmp_path / "run.rrd")
    assert said.startswith(f"--log-image video needs a video file as its input, not {name}: ")


@pytest.mark.parametrize(
    ("flags", "frames", "last", "rate"),
    [
        ([], "40", "1.560000000 s", "25 frames/s"),
        (["--max-frames", "2"], "at most 2", "?", "?"),
        (["--end", "0.1"], "at most 40", "?", "?"),
        (["--stride", "3"], "at most 14", "?", "?"),
        (["--start", "1"], "?", "1.560000000 s", "?"),
    ],
)
def test_a_selection_claims_nothing_of_the_whole(
    tmp_path: Path, flags: list[str], frames: str, last: str, rate: str
) -> None:
    shown = command(encode(tmp_path / "clip.mp4"), "--info", *flags).out
    rows = {name: text.strip() for name, text in (line.split(":", 1) for line in shown.splitlines())}
    assert (rows["frames"], rows["last time"], rows["rate"]) == (frames, last, rate)

"""Faults of the machine while the whole command line runs: no room, no folder, signals, odd clocks, odd images."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from airline.errors import InputError
from frontend.cli.settings import RunConfig
from frontend.frame import Frame
from frontend.pipeline import LineFrontend
from frontend.run import process
from frontend.sources import open_source
from logs import read_tracks
from logs.sinks.open import open_track_sink
from tests.helpers.command import command, python, recorded
from tests.helpers.sources import Listed
from tests.helpers.videos import encode

PERIOD_NS = 33_333_333


@pytest.fixture
def long_clip(clip: Path, tmp_path: Path) -> Path:
    """The clip, over and over, for half a minute at its own pace."""
    folder = tmp_path / "long"
    folder.mkdir()
    for number in range(900):
        os.link(clip / f"{number % 8}.png", folder / f"{number}.png")
    return folder


def wait_for(path: Path, bytes_: int, run: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 90
    while not path.exists() or path.stat().st_size < bytes_:
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize(("sign", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_being_told_to_end_is_like_ctrl_c(long_clip: Path, tmp_path: Path, sign: signal.Signals, code: int) -> None:
    """Also when it is told again and again, up to its end."""
    out, save, summary = tmp_path / "t.parquet", tmp_path / "t.rrd", tmp_path / "t.json"
    outputs = ("--out", out, "--save", save, "--summary", summary)
    before = signal.signal(sign, signal.SIG_DFL)  # under nohup it is ignored, by what is started here too
    with python(long_clip, "--realtime", *outputs, stdout=-1, stderr=-1) as run:
        signal.signal(sign, before)
        wait_for(Path(f"{out}.unfinished"), 200_000, run)
        while run.poll() is None:
            run.send_signal(sign)
            time.sleep(0.02)
        printed, said = run.communicate(timeout=30)
    assert run.returncode == code
    assert said.endswith("WARNING: interrupted: what was done so far is kept\n")
    assert "Traceback" not in said
    assert f"wrote {out}" in printed
    frames = [tracks.frame_index for tracks in read_tracks(out)]
    assert len(frames) == json.loads(summary.read_text())["frames"] > 5
    assert recorded(save)["/camera/tracks"]["frame"] == frames


def test_a_second_ctrl_c_is_no_traceback(long_clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "t.csv"
    with python(long_clip, "--realtime", "--out", out, stdout=-1, stderr=-1) as run:
        wait_for(out, 50_000, run)
        for _ in range(3):
            run.send_signal(signal.SIGINT)
            time.sleep(0.003)
        _, said = run.communicate(timeout=30)
    assert run.returncode in (130, -signal.SIGINT)  # a shell shows 130 for both: the last may find Python gone
    # a signal that lands in a weak reference's callback is swallowed and printed by Python itself
    said = re.sub(r"Exception ignored in.*?KeyboardInterrupt: ?\n", "", said, flags=re.DOTALL)
    assert "Traceback" not in said


def test_an_output_folder_that_is_removed_is_said_for_every_file(long_clip: Path, tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    names = ("t.csv", "t.parquet", "t.mcap")
    outputs = [flag for name in names for flag in ("--out", folder / name)]
    with python(long_clip, "--realtime", *outputs, "--save", folder / "t.rrd", stdout=-1, stderr=-1) as run:
        wait_for(folder / "t.csv", 50_000, run)
        for path in folder.iterdir():
            path.unlink()
        folder.rmdir()
        printed, said = run.communicate(timeout=30)
    assert run.returncode == 2
    errors = [line for line in said.splitlines() if line.startswith("error: ")]
    for name in (*names, "t.rrd"):
        assert any(name in line and "was removed or moved while it was written" in line for line in errors), name
    assert "wrote" not in printed
    assert "saved" not in printed
    assert "frames/s" in printed


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 2 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(folder)]
    if not sys.platform.startswith("linux") or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("cannot mount a small disk: test_track_sinks fills one by RLIMIT_FSIZE")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.parametrize("name", ["t.mcap", "t.parquet", "t.csv"])
def test_a_full_disk_ends_the_run_and_keeps_what_is_written(small_disk: Path, long_clip: Path, name: str) -> None:
    flags = {"t.mcap": ["--with-images"], "t.parquet": ["--realtime"]}.get(name, [])
    if name != "t.parquet":  # of which a batch holds a second, as many frames as there are by then
        (small_disk / "ballast").write_bytes(bytes(1_700_000))
    done = command(long_clip, "--out", small_disk / name, *flags)
    assert done.code == 2
    assert f"{name}" in done.err
    assert "No space left on device" in done.err
    found = small_disk / (f"{name}.unfinished" if name == "t.parquet" else name)
    assert found.stat().st_size > 100_000
    if name != "t.csv":
        assert len(list(read_tracks(found))) > 3
    else:
        assert len(found.read_bytes().splitlines()) > 100


def test_a_disk_without_room_for_a_recording_is_said(small_disk: Path, long_clip: Path) -> None:
    done = command(long_clip, "--save", small_disk / "t.rrd", "--realtime")
    assert done.code == 2
    assert "less than 50 MB are free: is the disk full?" in done.err
    assert recorded(small_disk / "t.rrd")["/camera/tracks"]["frame"][:3] == [0, 1, 2]


def test_a_clock_that_jumps_steps_back_or_stands_still(clip: Path, tmp_path: Path) -> None:
    hour = 3600 * 10**9
    stamps = [k * PERIOD_NS for k in range(4)]
    stamps += [stamps[-1]] * 2 + [hour, hour + PERIOD_NS, 2 * PERIOD_NS, 3 * PERIOD_NS, 2**62, 2**62]
    names = ("t.mcap", "t.parquet", "t.csv", "limap/")
    image = cv2.imread(str(clip / "0.png"))
    source = Listed([Frame(index, stamp_ns, image) for index, stamp_ns in enumerate(stamps)])
    code, summary = process(source, RunConfig(), (open_track_sink(f"{tmp_path}/{name}") for name in names))
    assert (code, summary.frames) == (0, len(stamps))
    for name in names[:2]:
        found = list(read_tracks(tmp_path / name))
        assert sorted(tracks.stamp_ns for tracks in found) == sorted(stamps)
        resets = [(tracks.reset or "").split(" ")[0] for tracks in sorted(found, key=lambda t: t.frame_index)]
        assert resets == [""] * 6 + ["gap", "", "time", "", "gap", ""]


@pytest.fixture(scope="module")
def frontend() -> LineFrontend:
    return LineFrontend()


def noise(*shape: int, dtype: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape, dtype)


IMAGES: dict[str, Callable[[], np.ndarray]] = {
    "black": lambda: np.zeros((120, 160), np.uint8),
    "white": lambda: np.full((120, 160), 255, np.uint8),
    "one colour": lambda: np.full((120, 160, 3), (10, 200, 30), np.uint8),
    "noise": lambda: noise(120, 160),
    "sixteen bits of noise": lambda: noise(120, 160, dtype=np.uint16),
    "1x1": lambda: np.zeros((1, 1), np.uint8),
    "20000x3": lambda: noise(3, 20000),
    "3x20000": lambda: noise(20000, 3),
    "8K": lambda: np.tile(np.uint8([[40] * 960 + [200] * 960]), (4320, 4)),
}


@pytest.mark.parametrize("name", IMAGES)
def test_odd_images_go_all_the_way(frontend: LineFrontend, tmp_path: Path, name: str) -> None:
    image = IMAGES[name]()
    names = ("t.mcap", "t.parquet", "t.csv", "limap/")
    sinks = [open_track_sink(f"{tmp_path}/{out}", with_images=name != "8K") for out in names]
    frontend.tracker = type(frontend.tracker)()
    for index in range(2):
        result = frontend.process(Frame(index, index * PERIOD_NS, image))
        assert np.isfinite(result.tracks.segments_px).all()
        for sink in sinks:
            sink.write(result)
    for sink in sinks:
        sink.close()
    flat = name in ("black", "white", "one colour", "1x1")
    assert (len(result.tracks) == 0) or not flat
    if name == "8K":
        assert len(result.tracks) >= 7, "the edges of the stripes"
    assert len(list(read_tracks(tmp_path / "t.parquet"))) == 2


@pytest.mark.parametrize("image", [np.zeros((48, 64), np.float32), np.full((48, 64), np.nan)])
def test_images_of_floats_are_refused_with_what_to_do(frontend: LineFrontend, image: Any) -> None:
    with pytest.raises(InputError, match=r"image has dtype float\d\d: convert it to uint8 or uint16"):
        frontend.process(replace(Frame(0, 0, image)))


def test_a_pipe_whose_sender_is_killed(tmp_path: Path) -> None:
    """What came so far is kept."""
    data = encode(tmp_path / "clip.ts", bf="0").read_bytes()
    os.mkfifo(tmp_path / "pipe")
    sender = ["import sys, time; out = open(sys.argv[1], 'wb'); out.write(open(sys.argv[2], 'rb').read())"]
    sender[0] += "; out.flush(); time.sleep(60)"
    (tmp_path / "clip.ts").write_bytes(data[: len(data) * 9 // 10])
    with subprocess.Popen([sys.executable, "-c", *sender, tmp_path / "pipe", tmp_path / "clip.ts"]) as run:
        source = open_source(tmp_path / "pipe")
        frames = iter(source)
        first = next(frames)
        run.kill()
        rest = list(frames)
    source.close()
    assert first.index == 0
    assert [frame.stamp_ns for frame in rest] == [40_000_000 * k for k in range(1, 1 + len(rest))]
    assert 5 < len(rest) < 39

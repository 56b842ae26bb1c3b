"""Bad input on the command line: one clear sentence and exit code 2, or a warning and a count; nothing is lost."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.helpers.command import EVERY_FRAME, command, recorded, refusal
from tests.helpers.videos import write_video

FRAMES = 8
EARLIER = b"an earlier recording"


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with an earlier recording in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.rrd").write_bytes(EARLIER)
    return tmp_path


def refuse(*arguments: object) -> str:
    """Run, check that it is refused in one sentence and leaves no trace, and return the sentence."""
    before = {path: path.read_bytes() for path in Path.cwd().rglob("*") if path.is_file()}
    sentence = refusal(*arguments, *(() if "--save" in arguments else ("--save", "run.rrd")))
    assert {path: path.read_bytes() for path in Path.cwd().rglob("*") if path.is_file()} == before
    return sentence


@pytest.mark.parametrize("name", ["missing.mp4", "missing", "missing/*.png", "missing.mcap", "missing.png", "", "98"])
def test_missing_input(desk: Path, name: str) -> None:
    assert {"": "video file", "98": "camera 98"}.get(name, name) in refuse(name)


@pytest.mark.parametrize("content", [b"", b"hello\n" * 99, bytes(9999), np.random.default_rng(0).bytes(9999)])
@pytest.mark.parametrize("name", ["file.mp4", "file.avi", "file.png", "file.mcap", "file.bag", "file.rrd", "file"])
def test_file_that_is_no_input(desk: Path, name: str, content: bytes) -> None:
    (desk / name).write_bytes(content)
    assert "file" in refuse(name)


def test_folder_without_images(desk: Path) -> None:
    (desk / "empty").mkdir()
    for name, content, hint in (("notes.txt", b"no image", "empty"), ("0.png", b"no image either", "0.png")):
        assert "empty" in refuse("empty")
        (desk / "empty" / name).write_bytes(content)
        assert hint in refuse("empty")


def test_wrong_weights(desk: Path, clip: Path) -> None:
    assert "mine.safetensors" in refuse(clip, "--weights", "mine.safetensors")
    Path("mine.safetensors").write_bytes(np.random.default_rng(0).bytes(50_000))
    assert "mine.safetensors" in refuse(clip, "--weights", "mine.safetensors")


def test_wrong_settings_file(desk: Path, clip: Path) -> None:
    for text, hint in {
        "[inputs]\nstride = 2": "inputs",
        "detector.grow.similarity = 1.5": "similarity",
        'detector.edges.weights = "mine.safetensors"': "mine.safetensors",
        "a = 1\na = 2": "TOML",
        "\x00\xff": "settings.toml",
    }.items():
        (desk / "settings.toml").write_text(text, encoding="latin-1")
        assert hint in refuse(clip, "--config", "settings.toml")


FLAGS = """
--colour: --colour | --max 3: --max | --stride 0: stride | --stride 1.5: --stride | --stride: --stride
--resize abc: abc | --resize 640x: 640x | --resize 0x0: resize | --resize 99999999999: resize
--start 5 --end 2: end | --start -1: start | --start nan: start | --start inf: start | --end nan: end | --end inf: end
--start soon: --start | --start 100: no frame | --max-frames 0: frames | --fps 0: fps | --fps nan: fps
--fps 1e9: frame rate | --topic /camera: topic | --preset best: best | --runtime tpu: tpu | another.mp4: another.mp4
--config missing.toml: missing.toml | --config .: settings file | --save missing/run.rrd: missing/run.rrd
--save run.mp4: run.mp4 | --save folder.rrd: folder.rrd | --summary missing/run.json: missing/run.json
--summary run.rrd: run.rrd
"""  # no abbreviations: a later flag could change their meaning


@pytest.mark.parametrize("case", [case.strip() for line in FLAGS.split("\n") for case in line.split(" | ") if case])
def test_impossible_flags(desk: Path, clip: Path, case: str) -> None:
    (desk / "folder.rrd").mkdir()
    flags, _, hint = case.partition(": ")
    assert hint in refuse(clip, *flags.split())
    if flags == "--save folder.rrd":
        assert "xxx" in refuse(clip, "--save", f"{'x' * 300}.rrd")


def test_cuda_where_there_is_none(desk: Path, clip: Path) -> None:
    import torch

    if torch.cuda.is_available():
        pytest.skip("this machine has CUDA")
    assert "CUDA" in refuse(clip, "--runtime", "cuda")


def test_summary_that_cannot_be_written_keeps_the_recording(desk: Path, clip: Path) -> None:
    (desk / "run.json").symlink_to("/dev/full")
    outcome = command(clip, "--save", "run.rrd", "--summary", "run.json")
    assert outcome.code == 2
    assert outcome.err.startswith("error: cannot write --summary run.json")
    assert "frames/s" in outcome.out
    assert recorded(Path("run.rrd"))["/camera/tracks"]["frame"] == list(range(FRAMES))


def warned(caplog: pytest.LogCaptureFixture) -> str:
    """The one warning there is."""
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    return record.getMessage()


def skipped(clip: Path) -> int:
    """Run the input, check that it is recorded whole as far as it was counted, and return the skipped frames."""
    outcome = command(clip, "--save", "run.rrd", "--summary", "run.json")
    assert (outcome.code, outcome.err) == (0, "")
    figures = json.loads(Path("run.json").read_text())
    lost = figures["skipped_frames"]
    shown = f"{figures['frames']} ({lost} skipped)" if lost else f"{figures['frames']} "
    assert re.search(rf"frames +. {re.escape(shown)}", outcome.out)
    rows = recorded(Path("run.rrd"))
    assert all(len(rows[path]["frame"]) == figures["frames"] for path in EVERY_FRAME)
    return int(lost)


def test_video_cut_in_the_middle(desk: Path, clip: Path, caplog: pytest.LogCaptureFixture) -> None:
    images = [cv2.imread(str(clip / f"{number}.png")) for number in range(FRAMES)]
    data = write_video(desk / "cut.avi", 3 * images).read_bytes()
    (desk / "cut.avi").write_bytes(data[: len(data) // 2])
    lost = skipped(Path("cut.avi"))
    assert lost == pytest.approx(1.5 * FRAMES, abs=2)
    assert f"skipped {lost} frames" in warned(caplog)


def test_unreadable_frame_in_the_middle(desk: Path, clip: Path, caplog: pytest.LogCaptureFixture) -> None:
    (desk / "room").mkdir()
    for picture in clip.iterdir():
        (desk / "room" / picture.name).write_bytes(picture.read_bytes()[: 500 if picture.name == "3.png" else None])
    assert skipped(Path("room")) == 1
    assert "3.png" in warned(caplog)
    assert recorded(Path("run.rrd"))["/camera/tracks"]["frame"] == [0, 1, 2, 4, 5, 6, 7]


def test_frames_of_changing_size_and_kind(desk: Path, clip: Path) -> None:
    (desk / "room").mkdir()
    image = cv2.imread(str(clip / "0.png"))
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    kinds = [image, image[:80, :100], gray, image.astype(np.uint16) * 256, image[:1, :1], image[:1], image[:2, :3]]
    kinds += [np.zeros_like(image), np.tile(image, (2, 3, 1)), image]
    for number, kind in enumerate(kinds):
        assert cv2.imwrite(str(desk / "room" / f"{number}.png"), kind)
    assert skipped(Path("room")) == 0
    log = recorded(Path("run.rrd"))["/log"]
    assert log["frame"] == [1, 2, 4, 5, 6, 7, 8, 9]
    assert "resolution changed from 160x120 to 100x80" in log["TextLog:text"][0][0]

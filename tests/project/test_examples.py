"""Every example runs as a user runs it."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from airline.network.weights import load_unet
from airline.scenes import RenderedClip
from logs import read_tracks
from tests.helpers.batch_logs import camera_log
from tests.helpers.command import Outcome, command, recorded
from tests.helpers.pages import ROOT

EXAMPLES = {path.stem: path for path in sorted((ROOT / "examples").glob("[0-9]*.py"))}


def example(stem: str, folder: Path, *arguments: object) -> Outcome:
    """An example, run in this process, which has loaded all it needs, and in a folder, where its temporary files go."""

    def run(words: list[str]) -> int:
        sys.argv = words
        runpy.run_path(words[0], run_name="__main__")
        return 0

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("PYTHONPATH", str(ROOT))  # for processes that it starts
        patch.setattr(sys, "argv", [])
        patch.setattr(tempfile, "tempdir", str(folder))
        done = command(EXAMPLES[stem], *arguments, main=run)
    return replace(done, code=1, err=f"{done.err}{done.code}\n") if isinstance(done.code, str) else done


def said(*arguments: object) -> str:
    """What an example prints that runs to its end."""
    done = example(*arguments)
    assert done.code == 0, done.err
    return done.out


def number_after(words: str, text: str) -> int:
    """The whole number that follows some words."""
    return int(re.search(rf"{words}\D*(\d+)", text).group(1))


SCORED = {"13_gtsam_in_one_page": 0.3, "14_mrob": 0.5}  # percent of the path's length, at most


SHORT = {"06_train_on_your_photographs": ("--steps", 3), "09_line_mapping": ("--frames", 20)}  # of 20 and 200
ELSEWHERE = {*SCORED, "10_line_odometry"}  # in `test_line_odometry`


@pytest.mark.parametrize("stem", [stem for stem in EXAMPLES if stem not in ELSEWHERE])
def test_runs(stem, short_built_in_clip, tmp_path):
    assert len(said(stem, tmp_path, *SHORT.get(stem, ())).splitlines()) >= 5


@pytest.mark.parametrize("stem", SCORED)
def test_odometry_in_one_file_scores_itself(stem, tmp_path):
    """Copied into an empty folder, with none of the files beside it."""
    path = EXAMPLES[stem]
    (tmp_path / path.name).write_bytes(path.read_bytes())
    environment = {**os.environ, "PYTHONPATH": str(packages(tmp_path / "packages"))}
    command = [sys.executable, path.name]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert number_after("keyframe", done.stdout) > 1
    assert int(re.findall(r"(\d+) lines in the map", done.stdout)[-1]) > 100
    assert float(re.search(r"path error (\S+) %", done.stdout).group(1)) < SCORED[stem]
    if stem == "13_gtsam_in_one_page":
        assert "60 frames, 60 poses" in done.stdout
        in_space = recorded(tmp_path / "odometry.rrd")["/world/lines"]
        assert in_space["frame"][0] < 20 < in_space["frame"][-1]
        assert len(in_space["track_id"][-1]) > 100


def packages(folder: Path) -> Path:
    """A folder with what the wheel holds, and no example."""
    folder.mkdir()
    for name in ("airline", "frontend", "logs", "viz"):
        (folder / name).symlink_to(ROOT / name)
    return folder


def test_dark_frames_draw_what_they_report(tmp_path):
    frame = RenderedClip(seed=3, effects=None).render(0).image
    cv2.imwrite(str(tmp_path / "frame.png"), frame)
    printed = said("03_dark_frames", tmp_path, "frame.png", "--out", "picture.png")
    counts = [int(line.split(": ")[1].split()[0]) for line in printed.splitlines()[:3]]
    picture = cv2.imread(str(tmp_path / "picture.png")).astype(int)
    assert picture.shape == (300, 1600, 3)
    coloured = (np.ptp(picture, axis=2) > 40).reshape(300, 4, 400).sum(axis=(0, 2))
    assert coloured[0] == 0
    assert coloured[3] > 2 * coloured[1], "AirLine sees in the dark, LSD does not"
    assert counts[2] > counts[0]


@pytest.fixture
def log(clip, tmp_path):
    """The clip in a log as ROS 2 writes it."""
    return camera_log(tmp_path / "drive.mcap", clip)


def test_tracks_of_a_log_read_back_as_they_were_counted(log, tmp_path):
    printed = said("04_mcap_log_to_tracks", tmp_path, log)
    for name in ("drive_tracks.parquet", "drive_tracks.mcap"):
        frames = list(read_tracks(tmp_path / name))
        assert number_after("frames:", printed) == len(frames) == 8
        assert number_after("tracks:", printed) == len(np.unique(np.concatenate([t.ids for t in frames]))) > 10
        assert number_after("observations:", printed) == sum(map(len, frames))

    seen = said("07_tracks_from_parquet", tmp_path, "drive_tracks.parquet")
    assert number_after("8 frames,", seen) == number_after("observations:", printed)
    assert sum(map(int, re.findall(r"frames: +(\d+) tracks", seen))) == number_after("tracks:", printed)
    refused = example("07_tracks_from_parquet", tmp_path, "drive_tracks.mcap")
    assert (refused.code, len(refused.err.splitlines())) == (1, 1)

    again = example("04_mcap_log_to_tracks", tmp_path, log)
    assert again.code == 1
    assert "give --overwrite" in again.err
    assert said("04_mcap_log_to_tracks", tmp_path, log, "--overwrite") == printed


def test_edge_detectors_draw_what_they_report(clip, tmp_path):
    from kornia.models.dexined import DexiNed

    torch.manual_seed(0)
    untrained = {name: tensor.half() for name, tensor in DexiNed(pretrained=False).state_dict().items()}
    save_file(untrained, tmp_path / "dexined.safetensors")
    arguments = ("--dexined", "dexined.safetensors", "--out", "picture.png", clip / "0.png")
    printed = said("05_another_edge_detector", tmp_path, *arguments)
    (tmp_path / "dexined.safetensors").unlink()  # 70 MB
    picture = cv2.imread(str(tmp_path / "picture.png")).astype(int)
    assert picture.shape == (240, 640, 3)
    coloured = (np.ptp(picture[120:], axis=2) > 100).reshape(120, 4, 160).sum(axis=(0, 2))
    counts = np.array([number_after(f"{name}:", printed) for name in ("default", "Canny", "Sobel", "DexiNed")])
    assert (counts[:3] > 10).all()
    assert (coloured >= 8 * counts).all(), "the shortest lines have 8 px"


def test_training_on_ones_own_photographs(clip, tmp_path):
    assert "poor weights" in said("06_train_on_your_photographs", tmp_path, "--steps", 2, clip)
    load_unet(tmp_path / "trial.safetensors")
    assert list((tmp_path / "trial-samples").iterdir())


@pytest.mark.parametrize(
    ("stem", "arguments"),
    [
        ("01_detect_one_image", ["none.png"]),
        ("03_dark_frames", ["none.png"]),
        ("04_mcap_log_to_tracks", ["none.mcap"]),
        ("05_another_edge_detector", ["none.png"]),
        ("05_another_edge_detector", ["--dexined", "none.pth"]),
        ("06_train_on_your_photographs", ["none"]),
        ("07_tracks_from_parquet", ["none.parquet"]),
        ("13_gtsam_in_one_page", ["none.mp4"]),
    ],
    ids=lambda value: value if isinstance(value, str) else Path(value[-1]).name,
)
def test_what_cannot_be_read_is_named_in_one_sentence(stem, arguments, tmp_path):
    done = example(stem, tmp_path, *arguments)
    assert done.code in (1, 2)
    (sentence,) = done.err.splitlines()
    assert Path(arguments[-1]).name in sentence or "cannot be read" in sentence
    assert done.out == ""

"""The command line on good input: what it prints, writes, records and shows."""

from __future__ import annotations

import json
import logging
import re
import statistics
import warnings
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from airline import __version__
from frontend.cli.terminal import set_up_logging
from frontend.cli.wiring import has_display
from logs import read_tracks
from tests.helpers.command import EVERY_FRAME, Outcome, command, curve, recorded, seen_tracks
from tests.helpers.ports import free_port
from tests.helpers.viewer import RERUN, saving_viewer
from viz.viewer import open_viewer

FRAMES = 8
FLAGS = (
    *("--save", "--headless", "--summary", "--max-frames", "--start", "--end", "--stride", "--resize"),
    *("--preset", "--weights", "--runtime", "--config", "--dump-config", "--version", "-v"),
)
STAGES = ["edges", "pixels", "orientation", "grow", "fit", "refine", "track", "sinks"]


@dataclass(frozen=True)
class Run:
    """One run of the command line on the shared clip."""

    outcome: Outcome
    rrd: Path
    figures: dict[str, Any]


@pytest.fixture(scope="module")
def run(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("run")
    outcome = command(clip, "--save", folder / "my run.rrd", "--summary", folder / "run.json")
    return Run(outcome, folder / "my run.rrd", json.loads((folder / "run.json").read_text()))


@pytest.fixture(scope="module")
def entities(run: Run) -> dict[str, dict[str, list[Any]]]:
    return recorded(run.rrd)


def tracks(entities: dict[str, dict[str, list[Any]]]) -> tuple[list[Any], list[Any], list[Any]]:
    """Segments, tracked segments and track ids per frame."""
    tracked = seen_tracks(entities)
    segments = entities["/camera/segments"]["LineStrips2D:strips"]
    return segments, tracked["LineStrips2D:strips"], tracked["track_id"]


def picture_size(entities: dict[str, dict[str, list[Any]]]) -> tuple[int, int]:
    blob = np.array(entities["/camera/image"]["EncodedImage:blob"][0][0], np.uint8)
    height, width = cv2.imdecode(blob, cv2.IMREAD_UNCHANGED).shape[:2]
    return width, height


def test_it_succeeds_and_says_how_to_look_at_the_result(run: Run) -> None:
    assert run.outcome.code == 0
    assert run.outcome.err == ""  # no progress bar either: this is no terminal
    assert run.outcome.out.endswith(f"saved {run.rrd}; look at it with: rerun '{run.rrd}'\n")


def test_table_and_json_hold_the_same_figures(run: Run) -> None:
    figures = run.figures
    assert figures.keys() >= {"frames", "fps", "lines_per_frame", "tracks", "track_length_median", "skipped_frames"}
    assert list(figures["stage_ms"]) == STAGES
    assert min(figures["stage_ms"].values()) > 0
    assert (figures["frames"], figures["skipped_frames"]) == (FRAMES, 0)
    row = r"^ (?:input|time|tracks|) +([a-z].*?)  +(\d[\d.]*)"
    shown = dict(re.findall(row, run.outcome.out, re.MULTILINE))
    titles = {
        "frames": "frames",
        "frames/s": "fps",
        "lines per frame": "lines_per_frame",
        "tracks per frame": "live_tracks_per_frame",
        "of these stable": "stable_tracks_per_frame",
        "of these measured, not detected": "measured_per_frame",
        "all tracks": "tracks",
        "seen in, median": "track_length_median",
    }
    expected = {title: figures[name] for title, name in titles.items()} | figures["stage_ms"]
    assert {title: float(value) for title, value in shown.items()} == pytest.approx(expected, abs=0.051)
    all_ms = sum(figures["stage_ms"].values())
    shares = {stage: ms / all_ms for stage, ms in figures["stage_ms"].items()}
    assert figures["stage_share"] == pytest.approx(shares, abs=1e-4)


def test_recording_has_one_row_per_frame_and_nothing_else(entities: dict[str, dict[str, list[Any]]]) -> None:
    rows = {path: columns["frame"] for path, columns in entities.items() if "frame" in columns}
    assert rows.pop("/camera/descriptor") == [0]
    assert rows.keys() == EVERY_FRAME
    assert all(numbers == list(range(FRAMES)) for numbers in rows.values())
    assert entities["/camera/image"]["sensor_time"] == [round(k * 1e9 / 30) for k in range(FRAMES)]
    assert entities["/__properties"]["RecordingInfo:name"] == [["room"]]


def test_figures_are_those_of_the_recording(run: Run, entities: dict[str, dict[str, list[Any]]]) -> None:
    segments, tracked, ids = tracks(entities)
    assert min(map(len, segments)) > 10
    assert [len(strips) for strips in tracked] == [len(row) for row in ids]
    assert run.figures["lines_per_frame"] == pytest.approx(statistics.mean(map(len, segments)), abs=0.005)
    assert run.figures["live_tracks_per_frame"] == pytest.approx(statistics.mean(map(len, ids)), abs=0.005)
    lengths = [length for length in Counter(k for row in ids for k in row).values() if length >= 3]
    assert run.figures["tracks"] == len(lengths) > 10
    assert run.figures["ids"] == len({k for row in ids for k in row}) > len(lengths)
    assert f"{len(lengths)} confirmed of {run.figures['ids']} ids" in run.outcome.out
    assert run.figures["track_length_median"] == statistics.median(lengths)
    for stage in STAGES[:-1]:  # the sink cannot record its own time
        spent = statistics.median(curve(entities, "time_ms", stage))
        assert run.figures["stage_ms"][stage] == pytest.approx(spent, abs=0.001)


def test_the_best_lines_alone_and_how_many_were_left_out(run: Run, clip: Path, tmp_path: Path) -> None:
    flags = ("--max-lines", 10, "--out", tmp_path / "best.parquet", "--summary", tmp_path / "run.json")
    outcome = command(clip, "--headless", *flags)
    figures = json.loads((tmp_path / "run.json").read_text())
    assert [len(tracks) for tracks in read_tracks(tmp_path / "best.parquet")] == [10] * FRAMES
    assert len(pq.read_table(tmp_path / "best.parquet", columns=["id"])["id"].unique()) == figures["ids"]
    assert figures["live_tracks_per_frame"] == 10
    assert figures["left_out_per_frame"] == pytest.approx(run.figures["live_tracks_per_frame"] - 10, abs=0.01)
    assert re.search(rf"left out by --max-lines +{figures['left_out_per_frame']:.1f} ", outcome.out)
    assert run.figures["left_out_per_frame"] == 0
    assert "left out" not in run.outcome.out


@pytest.mark.parametrize(
    ("flags", "frames"),
    [
        (["--stride", "3"], [0, 3, 6]),
        (["--start", "0.03", "--end", "0.2", "--stride", "2", "--max-frames", "2"], [1, 3]),
        (["--fps", "10", "--start", "0.5"], [5, 6, 7]),
        (["--start", "0.2", "--end", "100", "--max-frames", "100"], [6, 7]),
    ],
)
def test_frame_flags(clip: Path, tmp_path: Path, flags: list[str], frames: list[int]) -> None:
    assert command(clip, "--save", tmp_path / "run.rrd", "--summary", tmp_path / "run.json", *flags).code == 0
    assert recorded(tmp_path / "run.rrd")["/camera/tracks"]["frame"] == frames
    assert json.loads((tmp_path / "run.json").read_text())["frames"] == len(frames)


@pytest.mark.parametrize(("size", "expected"), [("80x40", (80, 40)), ("80X40", (80, 40)), ("80", (80, 60))])
def test_resize(clip: Path, tmp_path: Path, size: str, expected: tuple[int, int]) -> None:
    assert command(clip, "--save", tmp_path / "run.rrd", "--max-frames", 1, "--resize", size).code == 0
    assert picture_size(recorded(tmp_path / "run.rrd")) == expected


def test_paper_preset_and_canny_edges_run(clip: Path, tmp_path: Path) -> None:
    (tmp_path / "canny.toml").write_text('detector.edges.detector = "canny"\n')
    for flags in (["--preset", "paper"], ["--config", tmp_path / "canny.toml"]):
        outcome = command(clip, "--save", tmp_path / "run.rrd", "--max-frames", 3, "--runtime", "torch", *flags)
        assert outcome.code == 0
        assert max(map(len, tracks(recorded(tmp_path / "run.rrd"))[0])) > 0


def test_built_in_clip_without_an_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = command("--headless", "--max-frames", 2, "--resize", "160")
    assert outcome.code == 0
    assert "built-in clip, 160x120 colour" in outcome.out
    (rrd,) = tmp_path.iterdir()
    entities = recorded(rrd)
    assert entities["/camera/tracks"]["frame"] == [0, 1]
    assert "Pinhole:image_from_camera" in entities["/camera"]


@pytest.mark.parametrize("flags", [["--headless"], []])
def test_without_a_display_it_saves_under_the_name_of_the_input(clip, tmp_path, monkeypatch, flags):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    if flags:
        monkeypatch.setenv("DISPLAY", ":0")
    elif has_display():
        pytest.skip("this system always has a display")
    outcome = command(clip, "--max-frames", 1, *flags)
    assert outcome.code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["room.rrd"]
    assert "rerun room.rrd" in outcome.out


def test_with_a_display_everything_goes_to_the_viewer(clip, tmp_path, monkeypatch):
    """The viewer is Rerun's own, already open, and told to save what it receives instead of opening a window."""
    if not RERUN.exists():
        pytest.skip("Rerun's viewer is not installed beside this Python")
    port = free_port()
    (tmp_path / "cwd").mkdir()
    monkeypatch.chdir(tmp_path / "cwd")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("viz.viewer.open_viewer", partial(open_viewer, port))
    received = tmp_path / "received.rrd"
    with saving_viewer(port, received):
        outcome = command(clip)
    assert outcome.code == 0
    assert "saved" not in outcome.out
    assert not list(Path.cwd().iterdir())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a stream that was cut off has no table of contents
        rows = recorded(received)
    assert all(rows[path]["frame"] == list(range(FRAMES)) for path in EVERY_FRAME)


def test_help_and_version() -> None:
    text = command("--help").out
    assert all(flag in text for flag in FLAGS)
    assert command("--version") == Outcome(0, f"airline-frontend {__version__}\n", "")


def test_verbosity_is_about_our_own_packages() -> None:
    for verbosity, level in ((0, logging.WARNING), (1, logging.INFO), (2, logging.DEBUG), (5, logging.DEBUG)):
        set_up_logging(verbosity)
        assert {logging.getLogger(f"{name}.x").getEffectiveLevel() for name in ("frontend", "logs", "viz")} == {level}
        assert not logging.getLogger("numba").isEnabledFor(logging.DEBUG)
    set_up_logging(0)

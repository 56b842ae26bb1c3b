"""`python -m frontend.bench`: what it runs through, what it writes, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from frontend import bench
from frontend.bench import ClipSource, load_clips, main
from frontend.cli.settings import RunConfig


@pytest.mark.parametrize(("count", "expected"), [(1, [0] * 7), (2, [0, 1] * 3 + [0]), (4, [0, 1, 2, 3, 2, 1, 0])])
def test_the_clip_goes_forth_and_back(count: int, expected: list[int]) -> None:
    files = [cv2.imencode(".png", np.full((16, 16), 20 * number, np.uint8))[1].tobytes() for number in range(count)]
    frames = list(ClipSource(files, 7))
    assert [frame.image[0, 0] // 20 for frame in frames] == expected
    assert [frame.index for frame in frames] == list(range(7))
    assert len({frame.stamp_ns for frame in frames}) == 7


def test_every_size_shows_the_input(clip: Path) -> None:
    sizes = [(160, 120), (80, 60), (320, 200)]
    clips = load_clips(str(clip), sizes, RunConfig())
    for size, files in clips.items():
        frames = list(ClipSource(files, 8))
        for number, frame in enumerate(frames):
            assert f"{frame.image.shape[1]}x{frame.image.shape[0]}" == size
            original = cv2.resize(frame.image, (160, 120), interpolation=cv2.INTER_AREA).astype(float)
            assert np.abs(original - cv2.imread(str(clip / f"{number}.png"))).mean() < 8


def test_figures(clip, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bench, "ROUNDS", 1)
    out = tmp_path / "bench.json"
    assert main([str(clip), "--size", "160x120", "--frames", "10", "--preset", "fast", "--json", str(out)]) == 0
    written = json.loads(out.read_text())
    assert (written["preset"], written["frames"], list(written["sizes"])) == ("fast", 10, ["160x120"])
    figures = written["sizes"]["160x120"]
    for key in ("fps", "fps_serial", "fps_rerun", "fps_rerun_serial", "fps_mcap", "lsd_ms", "lines", "latency_ms"):
        assert figures[key] > 0
    assert {"edges", "track"} < figures["stage_ms"].keys()
    assert 5 < figures["peak_mb"] < 1000
    shown = capsys.readouterr().out
    assert "160x120" in shown
    assert f"{figures['fps']:.1f}" in shown

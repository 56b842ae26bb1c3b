"""The detector's benchmark: what it prints, writes and draws."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from airline.bench import main
from tests.helpers.command import refusal

STAGES = ["edges", "pixels", "orientation", "grow", "fit", "refine"]


@pytest.fixture
def all_cores() -> Iterator[None]:
    """`--threads` keeps the process to some cores; give them back."""
    cores = os.sched_getaffinity(0)
    yield
    os.sched_setaffinity(0, cores)


@pytest.fixture
def pictures(clip: Path) -> list[str]:
    return [str(path) for path in sorted(clip.iterdir())[:2]]


def test_figures(pictures, tmp_path, capsys, all_cores):
    file = tmp_path / "bench.json"
    flags = ["--size", "160x120", "--preset", "fast", "--rounds", "2", "--threads", "1", "--json", str(file)]
    assert main([*pictures, *flags]) == 0
    figures = json.loads(file.read_text())
    assert (figures["preset"], figures["size"], figures["pictures"]) == ("fast", "160x120", 4)
    assert list(figures["stage_ms"]) == list(figures["stage_p95_ms"]) == STAGES
    assert all(0 < figures["stage_ms"][stage] <= figures["stage_p95_ms"][stage] for stage in STAGES)
    assert max(figures["stage_ms"].values()) < figures["total_ms"] <= figures["total_p95_ms"]
    assert figures["ratio_lsd"] == pytest.approx(figures["lsd_ms"] / figures["total_ms"], rel=0.02)
    printed = capsys.readouterr().out
    for text in (*STAGES, "total", "LSD", f"{figures['ratio_lsd']:.2f}", f"{figures['batch_fps']:.0f} images/s"):
        assert text in printed


def test_cost_is_drawn_and_told(pictures, tmp_path, capsys):
    out = tmp_path / "cost.png"
    assert main([*pictures, "--cost", str(out), "--size", "160x120", "--rounds", "1"]) == 0
    assert cv2.imread(str(out)).shape[0] > 300
    printed = capsys.readouterr().out
    for text in ("80x60", "\n160x120", "480x360", f"wrote {out}"):
        assert text in printed


@pytest.mark.parametrize(
    ("flags", "hint"),
    [
        (["--size", "640"], "WIDTHxHEIGHT"),
        (["--size", "3x3"], "WIDTHxHEIGHT"),
        (["--rounds", "0"], "--rounds"),
        (["--threads", "9999"], "--threads"),
        (["--cost", "a.jpg"], ".png"),
        (["--json", "nowhere/figures.json"], "no folder"),
        (["missing.png"], "missing.png"),
    ],
)
def test_errors(flags, hint):
    assert hint in refusal(*flags, main=main)

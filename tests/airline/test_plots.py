"""The plots of evaluations."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from airline.evaluate import main as evaluate
from airline.evaluation.plots import draw_lp_curve, draw_performance, main, read_rivals
from tests.helpers.command import refusal


def _scores(shift: float, **more: Any) -> dict[str, Any]:
    lp = {"0": 30 + shift, "1": 70 + shift, "2": 80 + shift, "3": 85 + shift, "5": 90 + shift, "10": 95 + shift}
    return {"lp": lp, "p2": 80.0 + shift, "r2": 75.0, "f2": 77.0 + shift, "lines": 500.0, **more}


@pytest.fixture
def evaluations(tmp_path: Path) -> list[Path]:
    """Ours beside LSD, and a published detector that brings no times."""
    ours, other = tmp_path / "ours.json", tmp_path / "other.json"
    ours.write_text(json.dumps(_scores(1, ms=20.0, lsd=_scores(2, ms=10.0))))
    other.write_text(json.dumps(_scores(3)))
    return [ours, other]


def test_plots_are_pictures(dataset, tmp_path, capsys):
    """From what the evaluation command really writes."""
    ours, other, out = tmp_path / "ours.json", tmp_path / "other.json", tmp_path / "docs" / "plots"
    assert evaluate([str(dataset), "--limit", "1", "--json", str(ours)]) == 0
    assert evaluate([str(dataset), "--predictions", str(dataset / "lines_cho"), "--json", str(other)]) == 0
    capsys.readouterr()
    assert main([str(ours), str(other), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    for name in ("lp_curve.png", "performance.png"):
        assert str(out / name) in printed
        picture = cv2.imread(str(out / name))
        assert picture.shape[:2] == (672, 1040)
        assert (np.ptp(picture.astype(int), axis=2) > 60).any()


def test_lp_is_never_shown_without_a_precision(evaluations):
    (axes,) = draw_lp_curve(read_rivals(evaluations)).axes
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["AirLine, P2 81.0 %", "LSD, P2 82.0 %", "other, P2 83.0 %"]
    for line, shift in zip(axes.get_lines(), (1, 2, 3), strict=True):
        shown = dict(zip(line.get_xdata(), line.get_ydata(), strict=True))
        assert shown == {int(radius): value for radius, value in _scores(shift)["lp"].items()}


def test_performance_is_that_of_one_machine(evaluations, tmp_path):
    """A run on a busy machine took everybody three times as long, LSD too."""
    (axes,) = draw_performance(read_rivals(evaluations)).axes
    points = {text.get_text(): text.xy for text in axes.texts if hasattr(text, "xy")}
    assert points == {"AirLine": (50.0, 78.0), "LSD": (100.0, 79.0)}, "those that were timed"
    busy = tmp_path / "busy.json"
    busy.write_text(json.dumps(_scores(1, ms=60.0, lsd=_scores(2, ms=30.0))))
    assert read_rivals([evaluations[0], busy])["busy"].ms == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read"),
        (b"\xff\xfe", "is no evaluation"),
        (b"[]", "is no evaluation"),
        (b'{"images": 3}', "is no evaluation"),
        (json.dumps(_scores(10)).encode(), "is no evaluation"),  # an LP of 105 %
        (json.dumps(_scores(0)).encode(), "has no times or no LSD"),
    ],
)
def test_bad_evaluations_are_one_sentence(tmp_path, content, message):
    path = tmp_path / "ours.json"
    if content is not None:
        path.write_bytes(content)
    assert message in refusal(path, "--out", tmp_path / "plots", main=main)
    assert not (tmp_path / "plots").exists()


def test_what_else_goes_wrong(evaluations, tmp_path, monkeypatch):
    ours, other = evaluations
    assert "two detectors are called other" in refusal(ours, other, other, "--out", tmp_path / "plots", main=main)
    assert "cannot be written" in refusal(ours, "--out", other, main=main)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)  # as if it were not installed
    assert "airline-frontend[plots]" in refusal(ours, "--out", tmp_path / "plots", main=main)

"""The ablation command on a small drawn data set, and the plots of evaluations."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from airline.evaluate import main as evaluate
from airline.evaluation.ablate import main
from airline.evaluation.ablation import VARIANTS, HoughTransform, Variant, back_end, edge_detectors
from airline.evaluation.plots import draw_lp_curve, draw_performance, read_rivals
from airline.evaluation.plots import main as plot
from airline.stages.pixels import ThresholdPixels

ROWS = [
    "default",
    "6 kernels, T 0.3",
    "6 kernels, mean, T 0.994",
    "2 kernels, mean, T 0.995",
    "image gradient, T 0.8",
    "paper's line fit",
    "bare least squares",
    "no joining",
    "no end-point reach",
    "no refinement",
    "no least score",
    "no thinning",
    "fast network",
    "Canny",
    "sensitive Canny",
    "paper preset",
    "Hough transform",
    "LSD",
]

# the ablation


def _cells(row: dict[str, Any]) -> list[str]:
    """What the table shows of a row of the JSON."""
    scores = [*row["lp"].values(), row["p2"], row["r2"], row["f2"]]
    return [*(f"{value:.1f}" for value in scores), f"{row['lines']:.0f}", f"{row['ms']:.1f}"]


def test_command(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "ablation.json"
    assert main([str(dataset), "--json", str(out)]) == 0
    report = json.loads(out.read_text())
    assert report["images"] == 2
    rows = {row["name"]: row for row in report["rows"]}
    assert list(rows) == ROWS
    printed = capsys.readouterr().out.splitlines()
    assert max(map(len, printed)) <= 100
    for name, row in rows.items():
        assert list(row["lp"]) == ["0", "1", "2", "3", "5", "10"]
        assert all(math.isfinite(value) for key, value in row.items() if key not in ("name", "lp"))
        assert row["lines"] > 0
        assert row["ms"] > 0
        (line,) = (line for line in printed if line.strip().startswith(f"{name}  "))
        assert line.removeprefix(f" {name}").split() == _cells(row)
    assert rows["default"]["f2"] > 95
    assert rows["Canny"]["lp"] != rows["default"]["lp"]


def test_no_exchange_is_idle(clip: Path) -> None:
    """Every row of the table finds other lines than the default."""
    images = [cv2.imread(str(clip / f"{number}.png"), cv2.IMREAD_GRAYSCALE) for number in range(3)]
    edges = edge_detectors()

    def found(variant: Variant) -> np.ndarray:
        detect = back_end(variant.config, edges[variant.edges])
        return np.concatenate([detect(image, edges[variant.edges].detect(image)) for image in images])

    default = found(VARIANTS[0])
    for variant in VARIANTS[1:]:
        assert not np.array_equal(found(variant), default), variant.name


def test_hough_transform_finds_a_drawn_line() -> None:
    edges = np.zeros((60, 100), np.float32)
    edges[20, 10:91] = 1
    find = HoughTransform(ThresholdPixels())
    blank = np.zeros(edges.shape, np.uint8)
    assert np.sort(find(blank, edges), axis=1).tolist() == [[[10, 20], [90, 20]]]
    assert find(blank, np.zeros_like(edges)).shape == (0, 2, 2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--limit", "0"], "--limit"),
        (["--json", "nowhere/figures.json"], "no folder"),
    ],
)
def test_bad_arguments_are_one_sentence(
    dataset: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert main([str(dataset), *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert message in error
    assert error.count("\n") == 1


def test_missing_dataset_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: no folder")
    assert error.count("\n") == 1


# the plots


def _scores(shift: float, **more: Any) -> dict[str, Any]:
    lp = {
        str(radius): value + shift for radius, value in zip((0, 1, 2, 3, 5, 10), (30, 70, 80, 85, 90, 95), strict=True)
    }
    return {"lp": lp, "p2": 80.0 + shift, "r2": 75.0, "f2": 77.0 + shift, "lines": 500.0, **more}


@pytest.fixture
def evaluations(tmp_path: Path) -> list[Path]:
    """Ours beside LSD, and a published detector that brings no times."""
    ours, other = tmp_path / "ours.json", tmp_path / "other.json"
    ours.write_text(json.dumps(_scores(1, ms=20.0, lsd=_scores(2, ms=10.0))))
    other.write_text(json.dumps(_scores(3)))
    return [ours, other]


def test_plots_are_pictures(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From what the evaluation command really writes."""
    ours, other, out = tmp_path / "ours.json", tmp_path / "other.json", tmp_path / "docs" / "plots"
    assert evaluate([str(dataset), "--limit", "1", "--json", str(ours)]) == 0
    assert evaluate([str(dataset), "--predictions", str(dataset / "lines_cho"), "--json", str(other)]) == 0
    capsys.readouterr()
    assert plot([str(ours), str(other), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    for name in ("lp_curve.png", "performance.png"):
        assert str(out / name) in printed
        picture = cv2.imread(str(out / name))
        assert picture.shape[:2] == (672, 1040)
        ink = (picture < 250).any(axis=2)
        assert 0.01 < ink.mean() < 0.5
        colourful = np.ptp(picture.astype(int), axis=2) > 60
        assert colourful.any()


def test_lp_is_never_shown_without_a_precision(evaluations: list[Path]) -> None:
    (axes,) = draw_lp_curve(read_rivals(evaluations)).axes
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["AirLine, P2 81.0 %", "LSD, P2 82.0 %", "other, P2 83.0 %"]
    for line, shift in zip(axes.get_lines(), (1, 2, 3), strict=True):
        assert list(line.get_xdata()) == [0, 1, 2, 3, 5, 10]
        assert list(line.get_ydata()) == [30 + shift, 70 + shift, 80 + shift, 85 + shift, 90 + shift, 95 + shift]
    assert (
        len({line.get_color() for line in axes.get_lines()})
        == len({line.get_marker() for line in axes.get_lines()})
        == 3
    )


def test_performance_shows_who_was_timed(evaluations: list[Path]) -> None:
    (axes,) = draw_performance(read_rivals(evaluations)).axes
    points = {text.get_text(): text.xy for text in axes.texts if hasattr(text, "xy")}
    assert points == {"AirLine": (50.0, 78.0), "LSD": (100.0, 79.0)}


def test_performance_is_that_of_one_machine(evaluations: list[Path], tmp_path: Path) -> None:
    """A run on a busy machine took everybody three times as long, LSD too."""
    busy = tmp_path / "busy.json"
    busy.write_text(json.dumps(_scores(1, ms=60.0, lsd=_scores(2, ms=30.0))))
    assert read_rivals([evaluations[0], busy])["busy"].ms == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read"),
        ("not JSON", "is no evaluation"),
        (b"\xff\xfe", "is no evaluation"),
        ("[]", "is no evaluation"),
        ('{"images": 3}', "is no evaluation"),
        (json.dumps(_scores(10)), "is no evaluation"),  # an LP of 105 %
        (json.dumps(_scores(0)), "has no times or no LSD"),
    ],
)
def test_bad_evaluations_are_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | bytes | None, message: str
) -> None:
    path = tmp_path / "ours.json"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert plot([str(path), "--out", str(tmp_path / "plots")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "plots").exists()


def test_names_and_places_that_are_taken(
    evaluations: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ours, other = map(str, evaluations)
    assert plot([ours, other, other, "--out", str(tmp_path / "plots")]) == 2
    assert "two detectors are called other" in capsys.readouterr().err
    assert plot([ours, "--out", other]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_missing_matplotlib_is_one_sentence(
    evaluations: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)  # as if it were not installed
    assert plot([str(evaluations[0]), "--out", str(tmp_path / "plots")]) == 2
    assert "airline-frontend[plots]" in capsys.readouterr().err

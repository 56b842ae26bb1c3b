"""The ablation on a small drawn data set."""

from __future__ import annotations

import json
import math

import cv2
import numpy as np

from airline.evaluate import main
from airline.evaluation.ablation import VARIANTS, back_end, edge_detectors, hough_transform
from airline.stages.pixels import ThresholdPixels


def test_command(dataset, tmp_path, capsys):
    out = tmp_path / "ablation.json"
    assert main([str(dataset), "--ablate", "--json", str(out)]) == 0
    report = json.loads(out.read_text())
    rows = {row["name"]: row for row in report["rows"]}
    assert (report["images"], list(rows)) == (2, [*VARIANTS, "Hough transform", "LSD"])
    printed = capsys.readouterr().out
    for name, row in rows.items():
        assert list(row["lp"]) == ["0", "1", "2", "3", "5", "10"]
        assert all(math.isfinite(value) for key, value in row.items() if key not in ("name", "lp"))
        assert min(row["lines"], row["ms"]) > 0
        (line,) = (line for line in printed.splitlines() if line.strip().startswith(f"{name}  "))
        assert f"{row['f2']:.1f}" in line.split()
    assert rows["default"]["f2"] > 95
    assert rows["Canny"]["lp"] != rows["default"]["lp"]


def test_no_exchange_is_idle(clip):
    """Every row of the table finds other lines than the default."""
    images = [cv2.imread(str(clip / f"{number}.png"), cv2.IMREAD_GRAYSCALE) for number in range(3)]
    edges = edge_detectors()

    def found(name: str) -> np.ndarray:
        own = edges.get(name, edges["default"])
        detect = back_end(VARIANTS[name], own)
        return np.concatenate([detect(image, own.detect(image)) for image in images])

    default = found("default")
    for name in [*VARIANTS][1:]:
        assert not np.array_equal(found(name), default), name


def test_hough_transform_finds_a_drawn_line():
    edges = np.zeros((60, 100), np.float32)
    edges[20, 10:91] = 1
    find = hough_transform(ThresholdPixels())
    blank = np.zeros(edges.shape, np.uint8)
    assert np.sort(find(blank, edges), axis=1).tolist() == [[[10, 20], [90, 20]]]
    assert find(blank, np.zeros_like(edges)).shape == (0, 2, 2)

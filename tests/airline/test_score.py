"""Scores of lines: worked out by hand, and whether they tell true lines from false ones."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from airline import AirLine
from airline.config import DetectorConfig, FitConfig
from airline.evaluation.light import darken
from airline.evaluation.metrics import distance_to, draw
from airline.stages.score_parts import SHORT, line_scores
from airline.training.dataset import HELD_OUT_SEED, render_sample


def scores_of(support: np.ndarray, *lines: tuple[float, float, float, float]) -> list[float]:
    return line_scores(support.astype(np.float32), np.array(lines, np.float64)).tolist()


def test_scores_are_strength_and_length():
    support = np.zeros((40, 60))
    support[10], support[20], support[30, :30] = 1.0, 0.5, 1.0
    full, half, broken = scores_of(support, (5, 10, 45, 10), (5, 20, 45, 20), (10, 30, 50, 30))
    share = 40 / (40 + SHORT)
    assert full == pytest.approx(share)
    assert half == pytest.approx(share / 2)
    assert broken == pytest.approx(share / 2, abs=0.02), "half of it lies on no edge"
    assert scores_of(support, (5, 10, 15, 10))[0] == pytest.approx(0.5)
    assert scores_of(support, (-20, 10, 20, 10))[0] == pytest.approx(share / 2, abs=0.02), "nothing beyond the image"


@pytest.mark.parametrize("light", ["bright", "dark"])
def test_scores_rank_true_lines_first(light):
    detector = AirLine(config=DetectorConfig(fit=FitConfig(min_score=0)))
    scores, truth = [], []
    for number in range(4):
        sample = render_sample(number, HELD_OUT_SEED)
        gray = darken(sample.gray, number) if light == "dark" else sample.gray
        lines = detector(gray)
        distance = distance_to(draw(sample.pieces, gray.shape))
        at = lines.segments[:, :1] + np.diff(lines.segments, axis=1) * np.linspace(0, 1, 15, dtype=np.float32)[:, None]
        truth.append((cv2.remap(distance, at[..., 0], at[..., 1], cv2.INTER_NEAREST) <= 2).mean(axis=1) > 0.6)
        scores.append(lines.scores)
    true = np.concatenate(truth)
    order = np.argsort(np.argsort(np.concatenate(scores)))
    area = (order[true].mean() - order[~true].mean()) / len(true) + 0.5
    assert area > 0.75, "share of pairs of a true and a false line that are in order"

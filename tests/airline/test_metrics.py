"""Pixel scores: figures that can be worked out by hand, and the published detectors on YorkUrban."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from airline.evaluation.benchmark import measure_files
from airline.evaluation.dataset import load_dataset
from airline.evaluation.metrics import PixelScores, coverage, distance_to, draw, mean, pixel_scores

SHAPE = (40, 60)
ROW = (10, 10, 29, 10)  # 20 px
YORK_URBAN = Path(__file__).parents[3] / "shared" / "data" / "yorkurban_val"

# LP0, 1, 2, 3, 5, 10, P2, R2, F2 of the published outputs as this project first measured them
PUBLISHED = {
    "ag3line": (45.4, 82.7, 89.9, 92.9, 96.1, 98.8, 83.8, 80.1, 81.9),
    "mcmlsd": (34.7, 80.3, 91.0, 94.1, 96.5, 98.6, 73.9, 83.3, 78.3),
    "linelet": (32.3, 77.6, 88.1, 92.4, 96.1, 98.6, 81.4, 80.0, 80.7),
    "lcnn": (29.7, 64.8, 77.7, 83.8, 89.5, 95.4, 85.6, 59.4, 70.1),
    "hawp": (18.2, 40.9, 52.2, 57.8, 63.4, 72.6, 88.0, 37.5, 52.6),
}


def lines(*rows):
    return np.array(rows, float).reshape(-1, 2, 2)


@pytest.mark.parametrize(
    ("found", "annotated", "lp", "at_1", "at_2"),
    [
        ([ROW], [ROW], [100] * 6, (100, 100, 100), (100, 100, 100)),
        ([(10, 10, 19, 10)], [ROW], (50, 55, 60, 65, 75, 100), (100, 55, 11000 / 155), (100, 60, 75)),  # half of it
        ([(10, 10, 49, 10)], [ROW], [100] * 6, (52.5, 100, 10500 / 152.5), (55, 100, 11000 / 155)),  # twice as long
        ([(10, 11, 29, 11)], [ROW], (0, *[100] * 5), (100, 100, 100), (100, 100, 100)),
        ([(10, 12, 29, 12)], [ROW], (0, 0, *[100] * 4), (0, 0, 0), (100, 100, 100)),
        ([(10, 10, 10, 10)], [(11, 11, 11, 11)], (0, 0, *[100] * 4), (0, 0, 0), (100, 100, 100)),  # a disk
        ([], [ROW], [0] * 6, (100, 0, 0), (100, 0, 0)),
        ([ROW], [], [100] * 6, (0, 100, 0), (0, 100, 0)),
        ([], [], [100] * 6, (100, 100, 100), (100, 100, 100)),
    ],
)
def test_scores(found, annotated, lp, at_1, at_2):
    scores = pixel_scores(lines(*found), lines(*annotated), lines(*annotated), SHAPE)
    assert scores.lp == pytest.approx(lp)
    assert (scores.p1, scores.r1, scores.f1) == pytest.approx(at_1)
    assert (scores.p2, scores.r2, scores.f2) == pytest.approx(at_2)


def test_lp_reads_the_sparse_annotation_and_the_rest_the_dense_one():
    scores = pixel_scores(lines(ROW), lines(ROW), lines(ROW, (10, 25, 29, 25)), SHAPE)
    assert scores.lp == (100.0,) * 6
    assert (scores.p2, scores.r2) == (100.0, 50.0)


def test_f_score_of_a_mean_is_of_the_mean_precision_and_recall():
    both = mean([PixelScores((0.0,) * 6, 0, 0, 100, 0), PixelScores((50.0,) * 6, 0, 0, 50, 100)])
    assert (both.p2, both.r2, both.f2, both.f1, both.lp) == (75.0, 50.0, 60.0, 0.0, (25.0,) * 6)


def test_lines_are_drawn_between_the_nearest_pixels_and_cut_at_the_border():
    drawn = np.argwhere(draw(lines((2.4, 3.6, 5.6, 3.6)), (8, 10)))
    assert drawn.tolist() == [[4, 2], [4, 3], [4, 4], [4, 5], [4, 6]]
    assert draw(lines((-1000, 3, 1000, 3)), (8, 10)).sum() == 10
    assert not draw(lines((100, 100, 200, 300)), (8, 10)).any()


def test_distance_and_coverage():
    mask = np.zeros((5, 7), bool)
    assert np.isinf(distance_to(mask)).all()
    mask[1, 2] = True
    distance, (y, x) = distance_to(mask), np.mgrid[:5, :7]
    np.testing.assert_allclose(distance, np.hypot(y - 1, x - 2), atol=1e-5)
    assert coverage(np.ones_like(mask), distance, 1.5) == pytest.approx(100 * 9 / 35)


@pytest.mark.skipif(not YORK_URBAN.is_dir(), reason="YorkUrban's images and published detections are not here")
@pytest.mark.parametrize("detector", PUBLISHED)
def test_published_outputs_give_the_known_table(detector):
    figures = measure_files(load_dataset(YORK_URBAN), YORK_URBAN / "published_predictions" / detector)
    found = [*figures["lp"].values(), figures["p2"], figures["r2"], figures["f2"]]
    assert found == pytest.approx(PUBLISHED[detector], abs=0.2)

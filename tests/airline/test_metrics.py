"""Pixel scores: figures that can be worked out by hand, and the published detectors on YorkUrban."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from airline.evaluation.metrics import PixelScores, coverage, distance_to, draw, mean, pixel_scores

SHAPE = (40, 60)
NONE = np.zeros((0, 2, 2))
ROW = np.array([[[10, 10], [29, 10]]], float)  # 20 px
YORK_URBAN = Path(__file__).parents[3] / "shared" / "data" / "yorkurban_val"

# LP0, 1, 2, 3, 5, 10, P2, R2, F2 of the published outputs as this project first measured them
PUBLISHED = {
    "ag3line": (45.4, 82.7, 89.9, 92.9, 96.1, 98.8, 83.8, 80.1, 81.9),
    "mcmlsd": (34.7, 80.3, 91.0, 94.1, 96.5, 98.6, 73.9, 83.3, 78.3),
    "linelet": (32.3, 77.6, 88.1, 92.4, 96.1, 98.6, 81.4, 80.0, 80.7),
    "lcnn": (29.7, 64.8, 77.7, 83.8, 89.5, 95.4, 85.6, 59.4, 70.1),
    "hawp": (18.2, 40.9, 52.2, 57.8, 63.4, 72.6, 88.0, 37.5, 52.6),
}


def test_the_annotation_itself_is_perfect() -> None:
    scores = pixel_scores(ROW, ROW, ROW, SHAPE)
    assert scores == PixelScores((100.0,) * 6, 100.0, 100.0, 100.0, 100.0)
    assert scores.f1 == scores.f2 == 100.0


@pytest.mark.parametrize(
    ("ends", "lp", "at_1", "at_2"),
    [
        ((10, 10, 19, 10), (50, 55, 60, 65, 75, 100), (100, 55), (100, 60)),  # half of it
        ((10, 10, 49, 10), [100] * 6, (100 * 21 / 40, 100), (100 * 22 / 40, 100)),  # twice as long
        ((10, 11, 29, 11), (0, *[100] * 5), (100, 100), (100, 100)),  # beside it
        ((10, 12, 29, 12), (0, 0, *[100] * 4), (0, 0), (100, 100)),
    ],
)
def test_a_line_that_is_not_quite_right(
    ends: tuple[float, ...], lp: list[float], at_1: tuple[float, float], at_2: tuple[float, float]
) -> None:
    scores = pixel_scores(np.array(ends, float).reshape(1, 2, 2), ROW, ROW, SHAPE)
    assert scores.lp == pytest.approx(lp)
    assert (scores.p1, scores.r1, scores.p2, scores.r2) == pytest.approx((*at_1, *at_2))
    assert scores.f2 == pytest.approx(2 * at_2[0] * at_2[1] / sum(at_2))
    assert scores.f1 == pytest.approx(2 * at_1[0] * at_1[1] / max(sum(at_1), 1))


def test_lp_reads_the_sparse_annotation_and_the_rest_the_dense_one() -> None:
    other = ROW + (0, 15)
    scores = pixel_scores(ROW, ROW, np.concatenate([ROW, other]), SHAPE)
    assert scores.lp == (100.0,) * 6
    assert (scores.p2, scores.r2) == (100.0, 50.0)


def test_the_neighbourhood_is_a_disk() -> None:
    point, diagonal = np.full((1, 2, 2), 10.0), np.full((1, 2, 2), 11.0)
    assert pixel_scores(point, diagonal, diagonal, SHAPE).lp == (0, 0, 100, 100, 100, 100)


def test_nothing_detected() -> None:
    scores = pixel_scores(NONE, ROW, ROW, SHAPE)
    assert scores.lp == (0.0,) * 6
    assert (scores.p2, scores.r2, scores.f2, scores.f1) == (100.0, 0.0, 0.0, 0.0)


def test_nothing_annotated() -> None:
    scores = pixel_scores(ROW, NONE, NONE, SHAPE)
    assert scores.lp == (100.0,) * 6
    assert (scores.p2, scores.r2, scores.f2) == (0.0, 100.0, 0.0)
    assert pixel_scores(NONE, NONE, NONE, SHAPE).f2 == 100.0


def test_f_score_of_a_mean_is_of_the_mean_precision_and_recall() -> None:
    both = mean([PixelScores((0.0,) * 6, 0, 0, 100, 0), PixelScores((50.0,) * 6, 0, 0, 50, 100)])
    assert (both.p2, both.r2, both.f2, both.f1) == (75.0, 50.0, 60.0, 0.0)
    assert both.lp == (25.0,) * 6


def test_end_points_are_drawn_at_the_nearest_pixels() -> None:
    drawn = np.argwhere(draw(np.array([[[2.4, 3.6], [5.6, 3.6]]]), (8, 10)))
    assert drawn.tolist() == [[4, 2], [4, 3], [4, 4], [4, 5], [4, 6]]
    assert np.argwhere(draw(np.array([[[0.5, 1.5], [0.5, 1.5]]]), (8, 10))).tolist() == [[2, 0]]


def test_lines_are_cut_at_the_border() -> None:
    assert draw(np.array([[[-1000, 3], [1000, 3]]], float), (8, 10)).sum() == 10
    assert not draw(np.array([[[100, 100], [200, 300]]], float), (8, 10)).any()


def test_distance_and_coverage() -> None:
    mask = np.zeros((5, 7), bool)
    assert np.isinf(distance_to(mask)).all()
    mask[1, 2] = True
    distance = distance_to(mask)
    y, x = np.mgrid[:5, :7]
    np.testing.assert_allclose(distance, np.hypot(y - 1, x - 2), atol=1e-5)
    assert coverage(np.ones_like(mask), distance, 1) == pytest.approx(100 * 5 / 35)
    assert coverage(np.ones_like(mask), distance, 1.5) == pytest.approx(100 * 9 / 35)


@pytest.mark.parametrize("detector", PUBLISHED)
def test_published_outputs_give_the_known_table(detector: str) -> None:
    if not YORK_URBAN.is_dir():
        pytest.skip("the YorkUrban images and published detections are not part of the repository")
    from airline.evaluation.benchmark import measure_files
    from airline.evaluation.dataset import load_dataset

    figures = measure_files(load_dataset(YORK_URBAN), YORK_URBAN / "published_predictions" / detector)
    found = [*figures["lp"].values(), figures["p2"], figures["r2"], figures["f2"]]
    assert found == pytest.approx(PUBLISHED[detector], abs=0.2)

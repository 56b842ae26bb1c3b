"""Refinement by the image, exact where it is clear and careful where it is not; and scores of lines."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airline import AirLine, LineSet
from airline.config import DetectorConfig, FitConfig, RefineConfig
from airline.evaluation.benchmark import darken
from airline.evaluation.metrics import distance_to, draw
from airline.kernels.sampling import place_samples
from airline.stages.refine import ImageRefiner
from airline.stages.score_parts import SHORT, line_scores
from airline.training.dataset import HELD_OUT_SEED, render_sample
from tests.helpers.ideal import SIZE, ideal_line


def step_edge(line: np.ndarray, low: float = 60, high: float = 180) -> np.ndarray:
    """A half plane along a line, as softly bounded as a lens draws it; float grey levels."""
    y, x = np.mgrid[:SIZE, :SIZE]
    delta = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    signed = (x - line[0, 0]) * delta[1] - (y - line[0, 1]) * delta[0]
    return low + (high - low) * 0.5 * (1 + np.tanh(signed / 0.9))


def as_image(levels: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def displaced(line: np.ndarray, at_start: float, at_end: float) -> LineSet:
    """The line with its end points moved across it, px."""
    delta = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    normal = np.array([-delta[1], delta[0]])
    moved = np.stack([line[0] + at_start * normal, line[1] + at_end * normal])
    return LineSet(moved[None].astype(np.float32), np.ones(1, np.float32), np.ones((1, 6), np.float32))


def errors(lines: LineSet, line: np.ndarray) -> np.ndarray:
    """(2,) distance of both end points to the infinite true line, px."""
    delta = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    offset = lines.segments[0] - line[0]
    return np.abs(offset[:, 0] * delta[1] - offset[:, 1] * delta[0])


shifts = st.floats(-0.3, 0.3)


@settings(max_examples=60)
@given(st.floats(0, 180), shifts, shifts, shifts, shifts)
def test_lines_move_onto_the_edge(degrees, dx, dy, at_start, at_end):
    line = ideal_line(degrees, (dx, dy))
    lines = displaced(line, at_start, at_end)
    for image in (as_image(step_edge(line)), as_image(255 - step_edge(line))):
        refined = ImageRefiner().refine(lines, image)
        assert errors(refined, line).max() <= 0.05 + 0.15 * errors(lines, line).max()
        along = (refined.segments - lines.segments) @ (line[1] - line[0])
        assert np.abs(along).max() < 100 * 0.02, "lines move across themselves alone"
        assert np.array_equal(refined.scores, lines.scores)


@pytest.mark.parametrize(("low", "high", "shift"), [(40, 40, 0), (40, 80, 0.3)])
def test_noise_hardly_moves_a_line_and_a_noisy_edge_still_helps(low, high, shift):
    line, rng, left = ideal_line(73, (0.2, 0.1)), np.random.default_rng(0), []
    for _ in range(20):
        image = as_image(step_edge(line, low, high) + rng.normal(0, 8, (SIZE, SIZE)))
        left.append(errors(ImageRefiner().refine(displaced(line, shift, shift), image), line).max())
    assert np.median(left) < 0.2


def test_a_far_edge_leaves_the_line_alone():
    line = ideal_line(0, (0, 0))
    lines, image = displaced(line, 0.8, 0.8), as_image(step_edge(line))
    for refiner in (ImageRefiner(), ImageRefiner(RefineConfig(max_shift=0))):
        assert np.array_equal(refiner.refine(lines, image).segments, lines.segments)


@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (8, 200)])
def test_small_images_and_lines_on_the_rim(shape):
    height, width = shape
    image = np.random.default_rng(0).integers(0, 255, shape).astype(np.uint8)
    ends = [[[-0.5, -0.5], [width - 0.5, height - 0.5]], [[0, height - 0.5], [width - 0.5, height - 0.5]]]
    lines = LineSet(np.array(ends, np.float32), np.ones(2, np.float32), np.ones((2, 6), np.float32))
    refined = ImageRefiner().refine(lines, image).segments
    assert (refined >= -0.5).all()
    assert (refined <= np.array([width, height]) - 0.5).all()


def test_sixteen_bits_and_no_lines():
    line = ideal_line(45, (0.1, 0))
    image = (step_edge(line) * 200).astype(np.uint16)
    assert errors(ImageRefiner().refine(displaced(line, 0.3, -0.2), image), line).max() < 0.1
    none = LineSet(np.zeros((0, 2, 2), np.float32), np.zeros(0, np.float32), np.zeros((0, 6), np.float32))
    assert len(ImageRefiner().refine(none, image)) == 0


def test_lines_that_are_none_of_the_image_stay_where_they_are():
    image = np.zeros((60, 80), np.uint8)
    image[:, 40:] = 200
    ends = [[[-1e6, 30], [1e6, 30]], [[np.nan, 3], [4, 40]], [[10, np.inf], [20, 5]], [[39.2, 5], [39.2, 55]]]
    lines = LineSet(np.array(ends, np.float32), np.ones(4, np.float32), np.ones((4, 1), np.float32))
    refined = ImageRefiner().refine(lines, image).segments
    assert np.array_equal(refined[:3], lines.segments[:3], equal_nan=True)
    assert np.abs(refined[3, :, 0] - 39.5).max() < 0.1


@given(
    height=st.integers(2, 9),
    width=st.integers(2, 9),
    numbers=st.tuples(*[st.floats(width=32, allow_nan=True, allow_infinity=True)] * 4),
)
def test_no_place_lies_outside(height, width, numbers):
    """Whatever the line: compiled code looks at no bounds."""
    places, work = np.zeros(8, np.int32), np.zeros(16, np.float32)
    place_samples(width, height, *(np.float32(number) for number in numbers), 0, 8, places, work)
    columns, rows = places % width, places // width
    assert ((columns >= 0) & (columns <= width - 2)).all()
    assert ((rows >= 0) & (rows <= height - 2)).all()


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

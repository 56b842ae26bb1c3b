"""Refinement by the image, on step edges of known place: exact where it is clear, careful where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airline import LineSet
from airline.config import RefineConfig
from airline.stages.refine import ImageRefiner
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


@settings(max_examples=60, deadline=None)
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

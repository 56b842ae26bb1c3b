"""Lines that are looked for on an edge map: drawn ones, whose places are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from frontend.tracking.extents import GAP, supported
from frontend.tracking.guided import SHORTEST, measure
from tests.helpers.tracking_frames import EDGE, edge_map

WIDTH, HEIGHT = 200, 160
BAND = np.float32([3.0])
LINE = np.array([[40.0, 60.0], [160.0, 95.0]])


def piece(low: float, high: float, line: np.ndarray = LINE) -> np.ndarray:
    return line[0] + np.outer([low, high], line[1] - line[0])


def looked_for(edges: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Segment, rms distance of stations from it, and support."""
    found, residuals, support, _ = measure(edges, np.float32(line)[None], BAND)
    return found[0].astype(np.float64), float(residuals[0]), float(support[0])


def across(line: np.ndarray, points: np.ndarray) -> np.ndarray:
    delta = (line[1] - line[0]) / np.hypot(*(line[1] - line[0]))
    return (points - line[0]) @ [-delta[1], delta[0]]


@settings(max_examples=50)
@given(st.floats(0, 2 * np.pi), st.floats(-2, 2), st.floats(-2, 2), st.floats(30, 110))
def test_a_line_that_moved_is_measured_where_it_is(angle, first, last, length):
    ahead = np.array([np.cos(angle), np.sin(angle)])
    predicted = np.array([100, 80]) + np.outer([-length / 2, length / 2], ahead)
    assume((predicted >= 4).all() and (predicted < (WIDTH - 4, HEIGHT - 4)).all())
    true = predicted + np.outer([first, last], [-ahead[1], ahead[0]])
    edges = edge_map(true)
    found, residual, support = looked_for(edges, predicted)
    assert np.abs(across(true, found)).max() < 0.2
    assert np.abs((found - true) @ ahead).max() < 3.5, "one station"
    assert support > 0.8
    assert residual < 0.15
    backwards, _, _ = looked_for(edges, predicted[::-1])
    assert np.abs(across(true, backwards)).max() < 0.2
    assert (backwards[1] - backwards[0]) @ ahead < 0, "in the direction of what was predicted"


def test_a_broken_line_is_measured_by_its_pieces_and_ends_where_its_edge_does():
    found, _, support = looked_for(edge_map([piece(0.1, 0.45), piece(0.6, 0.8)]), LINE)
    assert np.abs(across(LINE, found)).max() < 0.2
    assert np.abs(found - piece(0.1, 0.8)).max() < 3
    assert support == pytest.approx(0.55 / 0.7, abs=0.08), "the share between its ends that has an edge"


def test_a_line_is_measured_beside_a_weaker_one_and_through_clutter():
    rng = np.random.default_rng(0)
    aside = np.array([-0.28, 0.96])
    edges = np.maximum(edge_map(LINE + 0.8 * aside), edge_map(LINE - 2.2 * aside, strength=0.4))
    spots = rng.uniform((30, 50), (170, 105), (12, 2))
    cluttered = np.maximum(edges, edge_map(np.stack([spots - 4, spots + 4], axis=1)))
    for image in (edges, cluttered):
        found, _, support = looked_for(image, LINE)
        assert np.abs(across(LINE + 0.8 * aside, found)).max() < 0.35
        assert support > 0.7


@pytest.mark.parametrize(
    "edges",
    [
        edge_map([]),
        edge_map(LINE, strength=0.1),
        edge_map(np.array([[100.0, 10], [100, 150]])),
        edge_map(np.array([[60.0, 50], [140, 110]])),
        edge_map(LINE + [0, 8]),
        edge_map(piece(0.4, 0.6)),
        np.full((HEIGHT, WIDTH), 0.9, np.float32),
    ],
    ids=["nothing", "too faint", "steeply across", "across", "beside the band", "a short piece", "edges everywhere"],
)
def test_nothing_is_found_where_no_line_is(edges):
    found, residual, support = looked_for(edges, LINE)
    assert support == residual == 0
    assert np.array_equal(found, np.float32(LINE))


@pytest.mark.parametrize(
    "line", [[[-50, 20], [-10, 60]], [[190, 150], [260, 220]], [[10, 10], [10, 10]], [[10, 10], [12, 11]]]
)
def test_outside_the_image_and_without_a_length_nothing_is_found(line):
    assert looked_for(edge_map(LINE), np.array(line, float))[2] == 0


def runs(lengths: list[int]) -> tuple[list[np.ndarray], np.ndarray]:
    """Stretches of edge and of none by turns, from x = 20 on, and which whole pixels have an edge."""
    ends = 20 + np.cumsum([0, *lengths])
    pieces = [np.array([[low, 80.0], [high, 80.0]]) for low, high in zip(ends[:-1:2], ends[1::2], strict=False)]
    return pieces, edge_map(pieces)


@settings(max_examples=50)
@given(st.lists(st.integers(2, 24), min_size=1, max_size=8), st.booleans())
@example([20, 4, 20], False)
@example([20, 8, 20], True)
def test_no_extent_reaches_over_pixels_without_an_edge(lengths, backwards):
    pieces, edges = runs(lengths)
    line = np.array([[20.0, 80.0], [190.0, 80.0]])
    seen, most = np.array([0.0, pieces[0][1, 0] - 20]) / 170, np.array([0.0, 1.0])
    if backwards:
        line, seen, most = line[::-1], 1 - seen[::-1], 1 - most[::-1]
    reached = supported(edges, line[None], seen[None], most[None])[0]
    x = line[0, 0] + reached * (line[1, 0] - line[0, 0])
    last = x.max()
    assert x.min() == pytest.approx(20)
    end = pieces[0][1, 0]
    for begin, stop in (p[:, 0] for p in pieces[1:]):
        if begin - end > GAP + 2 * EDGE + 2:
            break
        if begin - end > GAP:  # by a pixel's blur it may be either
            end = stop if last > begin else end
            continue
        end = stop
    assert end - 1 <= last <= end + GAP + 2 * EDGE + 1


def test_an_extent_ends_where_it_was_meant_to_on_a_whole_edge():
    inner, outer = np.array([[0.3, 0.5]]), np.array([[0.1, 0.8]])
    assert supported(edge_map(LINE), LINE[None], inner, outer) == pytest.approx(outer)
    assert supported(edge_map([]), LINE[None], inner, outer) == pytest.approx(inner), (
        "where nothing is nothing is added"
    )
    smaller = np.array([[0.4, 0.45]])
    assert supported(edge_map([]), LINE[None], inner, smaller) == pytest.approx(smaller), (
        "what was seen may be too much"
    )


def test_the_shortest_line_that_is_looked_for_can_be_measured():
    short = np.array([[60.0, 40.0], [60 + SHORTEST, 40.0]])
    found, _, support = looked_for(edge_map(short + [0, 0.7]), short)
    assert np.abs(across(short + [0, 0.7], found)).max() < 0.2
    assert support > 0.9

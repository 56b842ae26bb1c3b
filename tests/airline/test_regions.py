"""From edge pixels to lines: regions against an obvious implementation, their cuts, lines of known parameters."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from airline import AirLine, CannyEdges
from airline.config import EdgeConfig, GrowConfig, OrientationConfig
from airline.stages.grow import RegionGrower
from airline.stages.orientation import LineKernelOrientation
from airline.stages.parts import split_regions
from airline.stages.pixels import EdgePixels, ThresholdPixels
from tests.helpers.ideal import ANGLES, SIZE, binary_map, ideal_line, measure, soft_map


def random_edges(seed: int, height: int, width: int, density: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.where(rng.random((height, width)) < density, rng.random((height, width)), 0).astype(np.float32)


def plain_grow(edge, descriptors, grower: RegionGrower) -> list[int]:
    """Algorithm 1 of the paper, pixel by pixel with dictionaries."""
    place = {tuple(xy): row for row, xy in enumerate(edge.pixels.tolist())}
    labels = [-1] * len(edge.pixels)
    used: set[int] = set()
    region = 0
    for seed, weight in enumerate(edge.weights.tolist()):
        if seed in used or weight < grower.seed_threshold:
            continue
        used.add(seed)
        members, frontier = [seed], deque([seed])
        total = [float(v) for v in descriptors[seed]]
        while frontier:
            x, y = edge.pixels[frontier.popleft()].tolist()
            for neighbour in [(x + dx, y + dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]:
                row = place.get(neighbour)
                if row is None or row in used:
                    continue
                dot = sum(float(d) * t for d, t in zip(descriptors[row], total, strict=True))
                if dot >= grower.config.similarity * np.sqrt(sum(t * t for t in total)):
                    used.add(row)
                    members.append(row)
                    frontier.append(row)
                    total = [t + float(d) for t, d in zip(total, descriptors[row], strict=True)]
        if len(members) >= grower.config.min_pixels:
            for row in members:
                labels[row] = region
            region += 1
    return labels


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    density=st.floats(0, 1),
    similarity=st.floats(0, 1),
    min_pixels=st.integers(1, 12),
    subtract_mean=st.booleans(),
)
def test_agrees_with_the_plain_implementation(seed, height, width, density, similarity, min_pixels, subtract_mean):
    edges = random_edges(seed, height, width, density)
    edge = ThresholdPixels(EdgeConfig(threshold=0.2)).select(edges)
    describer = LineKernelOrientation(OrientationConfig(subtract_mean=subtract_mean))
    descriptors = describer.describe(edges, np.zeros(edges.shape, np.uint8), edge.pixels)
    grower = RegionGrower(GrowConfig(similarity=similarity, min_pixels=min_pixels), 0.5)
    labels = grower.grow(edge, descriptors)
    assert labels.tolist() == plain_grow(edge, descriptors, grower)
    assert np.array_equal(labels, grower.grow(edge, descriptors)), "not deterministic"


@pytest.mark.parametrize("preset", ["default", "paper"])
@pytest.mark.parametrize("turn", [0.0, 10.0, 22.5, 45.0, 67.0, 80.0])
def test_never_merges_the_sides_of_a_right_corner(preset, turn):
    corner, angles = np.array([SIZE / 2, SIZE / 2]), np.deg2rad([turn, turn + 90])
    edges = [soft_map(corner + np.outer([0, 60], [np.cos(angle), np.sin(angle)])) for angle in angles]
    trace = AirLine(preset, edges=CannyEdges()).trace_edges(np.maximum(*edges))
    assert len(trace.lines) == 2
    away = np.linalg.norm(trace.pixels - corner, axis=1) > 8
    side = np.abs((trace.pixels - corner) @ [-np.sin(angles), np.cos(angles)]).argmin(axis=1)
    for line in range(2):
        assert len(np.unique(side[away & (trace.labels == line)])) == 1


def selected(pixels: np.ndarray, shape: tuple[int, int]) -> EdgePixels:
    ones = np.ones(len(pixels), np.float32)
    return EdgePixels(np.zeros(shape, np.float32), pixels.astype(np.int32), pixels.astype(np.float32), ones)


def test_rows_with_more_pixels_than_16_bits_count() -> None:
    """Numbers of pixels in their row are 16 bits wide where that is enough."""
    width = (1 << 16) + 100
    edge = selected(np.stack([np.arange(width), np.ones(width, int)], axis=1), (3, width))
    assert not RegionGrower().grow(edge, np.tile(np.float32([1, 0]), (width, 1))).any()


def test_refuses_pixels_out_of_order() -> None:
    with pytest.raises(ValueError, match="raster order"):
        RegionGrower().grow(selected(np.array([[4, 3], [4, 2]]), (8, 8)), np.eye(2, dtype=np.float32))


DEVIATION = 2.5
Points = NDArray[np.float64]


def cut(*regions: Points) -> tuple[list[Points], NDArray[np.float64]]:
    """The pixels and the numbers of each part, weights being one."""
    positions = np.concatenate(regions).astype(np.float32)
    offsets = np.cumsum([0, *map(len, regions)])
    order = np.arange(len(positions))
    rows, bounds, moments = split_regions(positions, np.ones(len(positions), np.float32), order, offsets, DEVIATION)
    np.testing.assert_array_equal(np.sort(rows), order)  # every pixel once
    np.testing.assert_array_equal(np.sort(bounds, axis=0)[1:, 0], np.sort(bounds, axis=0)[:-1, 1])
    return [positions[rows[start:end]].astype(np.float64) for start, end in bounds], moments


def along(*corners: tuple[float, float], step: float = 1.0) -> Points:
    """Points on a polyline, about so far apart."""
    pieces = []
    for start, end in zip(np.array(corners[:-1]), np.array(corners[1:]), strict=True):
        count = max(2, round(np.hypot(*(end - start)) / step))
        pieces.append(start + (end - start) * (np.arange(count) / count)[:, None])
    return np.concatenate(pieces)


def test_straight_regions_stay_whole_and_a_corner_is_where_a_bent_one_is_cut() -> None:
    straight, bent = along((10, 10), (90, 30)), along((10, 80), (50, 80), (50, 140))
    parts, moments = cut(straight, bent)
    assert len(parts) == 3
    assert len(parts[0]) == len(straight)
    expected = np.array([[[10, 10], [90, 30]], [[50, 80], [50, 140]], [[10, 80], [50, 80]]])
    for ends, corners in zip(moments[:, 6:].reshape(-1, 2, 2), expected, strict=True):
        distances = np.linalg.norm(ends[:, None] - corners, axis=2)
        assert distances.min(axis=1).max() < 2.5


@settings(max_examples=60)
@given(
    steps=st.lists(st.tuples(st.integers(15, 60), st.floats(-1, 1)), min_size=1, max_size=12),
    noise=st.floats(0, 0.4),
)
def test_parts_add_up_and_none_that_is_left_bends(steps: list[tuple[int, float]], noise: float) -> None:
    points = along((0, 0), *np.cumsum([(dx, dx * slope) for dx, slope in steps], axis=0))
    points += np.random.default_rng(0).uniform(-noise, noise, points.shape)
    parts, moments = cut(points)
    for part, numbers in zip(parts, moments, strict=True):
        x, y = part.T
        sums = [len(part), x.sum(), y.sum(), (x * x).sum(), (x * y).sum(), (y * y).sum()]
        np.testing.assert_allclose(numbers[:6], sums, rtol=1e-9)
        ends = numbers[6:].reshape(2, 2)
        line = ends[1] - ends[0]
        places = (part - ends[0]) @ line / max(np.hypot(*line), 1e-9)
        assert places.min() > -1e-6
        assert places.max() < np.hypot(*line) + 1e-6
        if len(part) >= 12:
            first, last = part[places.argmin()], part[places.argmax()]
            chord = last - first
            across = np.abs((part - first) @ (chord[1], -chord[0])) / max(np.hypot(*chord), 1e-6)
            inner = (places > np.sort(places)[3]) & (places < np.sort(places)[-4])
            assert across[inner].max(initial=0) <= DEVIATION + 1e-4


def test_texture_is_not_cut_to_pieces() -> None:
    """A patch of noise: it crumbles from one end until so many parts wait, and the rest stays as it is."""
    y, x = np.mgrid[:30, :500]
    patch = np.stack([x.ravel(), y.ravel()], axis=1) + np.random.default_rng(0).normal(0, 0.1, (x.size, 2))
    parts, _ = cut(patch)
    assert len(parts) < 400
    assert max(map(len, parts)) > 9000


CASES = [(soft_map, shift) for shift in [(0.0, 0.0), (0.3, 0.2), (-0.45, 0.4)]]
# a staircase of whole pixels can stand only for a line through pixel centres
CASES += [(binary_map, (0.5, 0.5))]


def errors(preset, draw, shift):
    """(angles, 3) errors, of which the worst are printed."""
    lines = [ideal_line(angle, shift) for angle in ANGLES]
    found, *rows = zip(*(measure(preset, draw(line), line) for line in lines), strict=True)
    assert set(found) == {1}
    angle, offset, ends = np.max(rows, axis=1)
    print(f"{preset:8} {draw.__name__:10} angle {angle:.3f} deg  offset {offset:.3f} px  end points {ends:.2f} px")
    return np.transpose(rows)


@pytest.mark.parametrize(("draw", "shift"), CASES)
def test_default_is_exact(draw, shift):
    assert (errors("default", draw, shift).max(axis=0) <= [0.2, 0.1, 1.5]).all()


def test_paper_finds_every_line_with_a_larger_error():
    paper, default = (errors(preset, soft_map, (0.3, 0.2)) for preset in ("paper", "default"))
    assert (paper.mean(axis=0) > default.mean(axis=0)).all()
    assert (paper.max(axis=0)[:2] <= 0.5).all()

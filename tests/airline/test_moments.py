"""Fit of regions by moments, and the cuts of bent ones."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from airline.stages.split_regions import split_regions

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


@settings(max_examples=60, deadline=None)
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

"""Region grow against an obvious implementation of the same rules, and its promises."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airline import AirLine, CannyEdges
from airline.config import EdgeConfig, GrowConfig, OrientationConfig
from airline.stages.grow import RegionGrower
from airline.stages.orientation import LineKernelOrientation
from airline.stages.pixels import EdgePixels, ThresholdPixels
from tests.helpers.ideal import SIZE, soft_map


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


@settings(max_examples=60, deadline=None)
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
    corner = np.array([SIZE / 2, SIZE / 2])
    sides = [
        corner + np.outer([0, 60], [np.cos(angle), np.sin(angle)])
        for angle in (np.deg2rad(turn), np.deg2rad(turn + 90))
    ]
    edges = np.maximum(soft_map(sides[0]), soft_map(sides[1]))
    trace = AirLine(preset, edges=CannyEdges()).trace_edges(edges)
    assert len(trace.lines) == 2
    away = np.linalg.norm(trace.pixels - corner, axis=1) > 8
    side_of = np.argmin(
        [np.abs((trace.pixels - corner) @ [-np.sin(a), np.cos(a)]) for a in np.deg2rad([turn, turn + 90])], axis=0
    )
    for line in range(2):
        assert len(np.unique(side_of[away & (trace.labels == line)])) == 1


def test_rows_with_more_pixels_than_16_bits_count() -> None:
    """Numbers of pixels in their row are 16 bits wide where that is enough."""
    width = (1 << 16) + 100
    pixels = np.stack([np.arange(width), np.ones(width, int)], axis=1).astype(np.int32)
    ones = np.ones(width, np.float32)
    edge = EdgePixels(np.zeros((3, width), np.float32), pixels, pixels.astype(np.float32), ones)
    assert not RegionGrower().grow(edge, np.stack([ones, 0 * ones], axis=1)).any()


def test_refuses_pixels_out_of_order() -> None:
    pixels = np.array([[4, 3], [4, 2]], np.int32)
    edge = EdgePixels(np.zeros((8, 8), np.float32), pixels, pixels.astype(np.float32), np.ones(2, np.float32))
    with pytest.raises(ValueError, match="raster order"):
        RegionGrower().grow(edge, np.eye(2, dtype=np.float32))

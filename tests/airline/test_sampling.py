"""Samples of images between their pixels, many at once, against one at a time."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.kernels.sampling import interpolate, pack_neighbours, place_samples, sum_samples
from airline.stages.score_parts import bilinear

PLACES = st.floats(-3, 33, width=32)


@settings(max_examples=200, deadline=None)
@given(
    height=st.integers(2, 20),
    width=st.integers(2, 30),
    start=st.tuples(PLACES, PLACES),
    step=st.tuples(st.floats(-2, 2, width=32), st.floats(-2, 2, width=32)),
    first=st.integers(0, 3),
    count=st.integers(0, 40),
    seed=st.integers(0, 99),
)
def test_samples_are_bilinear(height, width, start, step, first, count, seed):
    image = np.random.default_rng(seed).integers(0, 256, (height, width), np.uint8)
    places, work = np.zeros(64, np.int32), np.zeros(128, np.float32)
    x, y, dx, dy = (np.float32(value) for value in (*start, *step))
    steps = np.arange(count, dtype=np.float32)
    columns, rows = np.clip(x + steps * dx, 0, width - 1), np.clip(y + steps * dy, 0, height - 1)
    expected = np.array([bilinear(image, *place) for place in zip(columns, rows, strict=True)])

    place_samples(width, height, x, y, dx, dy, first, count, places, work)
    for values in (image.ravel(), image.astype(np.float32).ravel()):
        assert abs(sum_samples(values, width, first, count, places, work) - expected.sum()) <= 0.01 * max(1, count)
    interpolate(pack_neighbours(image), first + count, places, work)
    np.testing.assert_allclose(work[first : first + count], expected, atol=0.01)


@given(
    height=st.integers(2, 9),
    width=st.integers(2, 9),
    numbers=st.tuples(*[st.floats(width=32, allow_nan=True, allow_infinity=True)] * 4),
)
def test_no_place_lies_outside(height, width, numbers):
    places, work = np.zeros(8, np.int32), np.zeros(16, np.float32)
    place_samples(width, height, *(np.float32(number) for number in numbers), 0, 8, places, work)
    columns, rows = places % width, places // width
    assert (columns <= width - 2).all()
    assert (columns >= 0).all()
    assert (rows >= 0).all()
    assert (rows <= height - 2).all()

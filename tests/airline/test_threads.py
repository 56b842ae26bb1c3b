"""Work on one image that several threads share."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airline import AirLine
from airline.kernels.threads import MOST, ThreadTeam


@given(threads=st.integers(-1, 9), count=st.integers(0, 1000), least=st.integers(1, 300))
def test_every_piece_is_done_once_and_in_order(threads: int, count: int, least: int) -> None:
    parts = ThreadTeam(threads).map_range(count, least, lambda start, end: list(range(start, end)))
    assert [piece for part in parts for piece in part] == list(range(count))
    assert 1 <= len(parts) <= max(1, min(threads, MOST))
    assert len(parts) == 1 or min(map(len, parts)) >= least


def test_an_error_of_any_part_is_raised() -> None:
    def fail_at_the_end(start: int, end: int) -> None:
        if end == 100:
            raise ValueError("the last part")

    with pytest.raises(ValueError, match="the last part"):
        ThreadTeam(4).map_range(100, 1, fail_at_the_end)
    assert ThreadTeam(4).map_range(4, 1, lambda start, end: end) == [1, 2, 3, 4]


def halves() -> None:
    assert ThreadTeam(2).map_range(10, 1, lambda start, end: end - start) == [5, 5]


def test_a_fork_has_threads_of_its_own() -> None:
    halves()
    process = multiprocessing.get_context("fork").Process(target=halves)
    process.start()
    process.join(20)
    assert process.exitcode == 0


def test_any_number_of_threads_gives_the_same_bits(scene: np.ndarray) -> None:
    edges = AirLine(threads=1).edges
    alone = AirLine(threads=1, edges=edges).trace(scene)
    for threads in (2, 3, 4):
        team = AirLine(threads=threads, edges=edges).trace(scene)
        for name in ("pixels", "positions", "descriptors", "labels"):
            np.testing.assert_array_equal(getattr(team, name), getattr(alone, name), name)
        np.testing.assert_array_equal(team.lines.segments, alone.lines.segments)
        np.testing.assert_array_equal(team.lines.scores, alone.lines.scores)

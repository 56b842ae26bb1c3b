"""Stages that run at once: the order of what comes out, errors, ends, and how much is read ahead."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from functools import partial
from itertools import count
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frontend.pipelined import WAITING, WAITING_LIVE, pipelined

ROOT = Path(__file__).parents[2]


class FaultError(Exception):
    """What a stage fails with."""


@pytest.fixture(autouse=True)
def no_thread_stays() -> Iterator[None]:
    before = threading.active_count()
    yield
    assert threading.active_count() == before


def slow(name, delays_ms, fails_at=None, taken=None):
    """A stage that adds its name to an item, after a while; fails at one item. It notes what it has taken."""
    calls = count()

    def stage(item: list[object]) -> list[object]:
        if taken is not None:
            taken.append(item[0])
        call = next(calls)
        time.sleep(1e-3 * delays_ms[call % len(delays_ms)])
        if call == fails_at:
            raise FaultError(name, call)
        return [*item, name]

    return stage


def source(length: int, delays_ms: list[int], fails_at: int | None) -> Iterator[list[object]]:
    for number in range(length):
        time.sleep(1e-3 * delays_ms[number % len(delays_ms)])
        if number == fails_at:
            raise FaultError("source", number)
        yield [number]


DELAYS = st.lists(st.integers(0, 3), min_size=1, max_size=5)


@settings(max_examples=150)
@given(
    length=st.integers(0, 14),
    delays=st.lists(DELAYS, min_size=6, max_size=6),
    stages=st.integers(1, 4),
    fault=st.none() | st.tuples(st.integers(0, 4), st.integers(0, 14)),
    stop_after=st.none() | st.integers(0, 14),
    read_ahead=st.booleans(),
)
def test_results_are_those_of_one_after_the_other(length, delays, stages, fault, stop_after, read_ahead):
    """Everything in order, or everything before the fault and then the fault itself."""
    place, item = fault if fault is not None and fault[0] <= stages and fault[1] < length else (None, length)
    names = [f"stage {number}" for number in range(1, stages + 1)]
    taken: list[list[object]] = [[] for _ in names]
    steps = [slow(name, delays[k + 1], item if place == k + 1 else None, taken[k]) for k, name in enumerate(names)]
    before = threading.active_count()
    results = pipelined(source(length, delays[0], item if place == 0 else None), *steps, read_ahead=read_ahead)
    found = []
    caught: FaultError | None = None
    try:
        for result in results:
            time.sleep(1e-3 * delays[-1][len(found) % len(delays[-1])])
            found.append(result)
            if len(found) == stop_after:
                results.close()
                break
        else:
            assert place is None
    except FaultError as error:
        caught = error
    if caught is not None:
        assert place is not None
        assert caught.args == (["source", *names][place], item)
        deepest = traceback.extract_tb(caught.__traceback__)[-1]
        assert (deepest.filename, deepest.name) == (__file__, "source" if place == 0 else "stage")
        for items in taken[max(place - 1, 0) :]:
            assert items[-1:] <= [item], "nothing behind an error"
    for items in taken:
        assert items == list(range(len(items))), "each once, in order"
    expected = [[number, *names] for number in range(item)]
    assert found == (expected[:stop_after] if stop_after else expected)
    assert threading.active_count() == before


def test_stages_overlap() -> None:
    """Reading and three stages are in the middle of one item each at the same moment."""
    together = threading.Barrier(4)

    def meet(item: int, at: int) -> int:
        if item == at:
            together.wait(20)
        return item

    steps = [partial(meet, at=2), partial(meet, at=1), partial(meet, at=0)]
    assert list(pipelined((meet(item, 3) for item in range(8)), *steps)) == list(range(8))


@pytest.mark.parametrize("read_ahead", [True, False])
def test_so_much_is_read_ahead_and_no_more(read_ahead: bool) -> None:
    """A live source is read by the first stage when that is free: what was read waits, and gets old."""
    read: list[int] = []
    readers, workers = set(), set()

    def endless() -> Iterator[int]:
        for number in count():
            read.append(number)
            readers.add(threading.get_ident())
            yield number

    def first(item: int) -> int:
        workers.add(threading.get_ident())
        return item

    most = 3 + WAITING if read_ahead else 2 + WAITING_LIVE
    results = pipelined(endless(), first, lambda item: item, read_ahead=read_ahead)
    for number in range(5):
        assert next(results) == number
        deadline = time.monotonic() + 20
        while len(read) - number < most and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(0.05)
        assert len(read) - number == most
    results.close()
    assert (readers == workers) == (not read_ahead)


def test_a_stage_may_not_end_the_stream() -> None:
    """StopIteration out of a stage is a fault, and no end that would hide what is left."""
    with pytest.raises(RuntimeError):
        list(pipelined(iter([1, 2, 3]), lambda item: next(iter([]))))


def test_an_interrupt_ends_the_wait_for_an_item() -> None:
    woken = threading.Event()

    def items() -> Iterator[int]:
        yield 0
        woken.wait(60)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the parent ignores it
    results = pipelined(items(), lambda item: item, stop=woken.set)
    assert next(results) == 0
    main = threading.main_thread().ident
    assert main is not None
    threading.Timer(0.1, signal.pthread_kill, (main, signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        next(results)
    signal.signal(signal.SIGINT, before)


def test_results_are_let_go() -> None:
    """What the consumer has dropped is not kept by the stages."""
    alive = 0

    class Big:
        def __init__(self) -> None:
            nonlocal alive
            alive += 1

        def __del__(self) -> None:
            nonlocal alive
            alive -= 1

    most = 0
    for _ in pipelined((Big() for _ in range(200)), lambda item: item, lambda item: item):
        most = max(most, alive)
    assert most <= 3 + WAITING + 2  # and those in a hand while they are passed on


@pytest.mark.parametrize("end", ["pass", "results.close()", "raise SystemExit(7)", "del results"])
def test_a_program_that_stops_in_the_middle_ends(end: str) -> None:
    code = f"""
from itertools import count
from frontend.pipelined import pipelined
results = pipelined(count(), lambda n: n + 1, lambda n: 2 * n)
assert next(results) == 2
{end}
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=30, capture_output=True, text=True)
    assert done.stderr == ""
    assert done.returncode == (7 if "7" in end else 0)

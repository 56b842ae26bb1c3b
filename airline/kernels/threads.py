"""A pool of threads that share the work on one image, for stages whose compiled code releases the GIL."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from airline.kernels.atomics import set_and_watch, wait_for_all

Item = TypeVar("Item")
T = TypeVar("T")
MOST = 4  # threads: the work takes a few milliseconds, and more cost more than they do
SPINS = 2000  # for the next piece of work, or for its end; some hundred nanoseconds each
GRACE = 10  # spins until who hands work over has begun its own part, and with that released the GIL


def cores() -> int:
    """How many cores this process may use: AIRLINE_CORES of the environment, or those that the system leaves it."""
    given = os.environ.get("AIRLINE_CORES", "")
    if given.isdecimal() and int(given):
        return int(given)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def map_ahead(work: Callable[[Item], T], items: Iterable[Item], threads: int) -> Generator[T, None, None]:
    """`work(item)` of each item, in order, done ahead in so many threads; closing it drops what has not begun."""
    with ThreadPoolExecutor(threads) as pool:
        ahead: deque[Future[T]] = deque()
        try:
            for item in items:
                ahead.append(pool.submit(work, item))
                if len(ahead) > 2 * threads:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for result in ahead:
                result.cancel()


class ThreadTeam:
    """Does a piece of work in parts on so many threads, the caller's included; by default on all cores."""

    def __init__(self, threads: int | None = None) -> None:
        self.threads = max(1, min(cores() if threads is None else threads, MOST))

    def map_range(self, count: int, least: int, work: Callable[[int, int], T]) -> list[T]:
        """Call `work(start, end)` for parts that make up `range(count)`; the answers, in order.

        Args:
            count: of what there is to do.
            least: parts are not smaller than this: handing one over takes some 20 microseconds.
            work: its result must not depend on how the range is divided.
        """
        parts = max(1, min(self.threads, count // least))
        if parts == 1:
            return [work(0, count)]
        call = _Call(work, [count * part // parts for part in range(parts + 1)])
        _pool().help_with(call, parts - 1)
        return call.finish()


class _Call:
    """A piece of work in parts."""

    def __init__(self, work: Callable[[int, int], Any], bounds: list[int]) -> None:
        self._work = work
        self._todo: SimpleQueue[tuple[int, int, int]] = SimpleQueue()
        for part, (start, end) in enumerate(pairwise(bounds)):
            self._todo.put((part, start, end))
        self._answers: list[Any] = [None] * (len(bounds) - 1)
        self._errors: list[BaseException] = []
        self._done = np.zeros(len(bounds) - 1, np.int32)
        self._ends: SimpleQueue[None] = SimpleQueue()  # to sleep for, if need be

    def take_parts(self) -> NDArray[np.int32]:
        """Do parts until none is left.

        Returns (1,) the flag of our last part, which the caller sets: then it is known that all of ours are done.
        """
        flag = np.zeros(1, np.int32)
        while True:
            try:
                part, start, end = self._todo.get_nowait()
            except Empty:
                return flag
            flag[0] = 1
            try:
                self._answers[part] = self._work(start, end)
            except BaseException as error:
                self._errors.append(error)
            self._ends.put(None)
            flag = self._done[part : part + 1]

    def finish(self) -> list[Any]:
        """What there is left to do; then all answers, or an error of any part."""
        self.take_parts()[0] = 1
        if not wait_for_all(self._done, SPINS):
            for _ in self._answers:
                self._ends.get()
        if self._errors:
            raise self._errors[0]
        return self._answers


class _Pool:
    """Threads that take part in calls; they end with the program."""

    def __init__(self) -> None:
        self._calls: SimpleQueue[_Call] = SimpleQueue()
        self._bell = np.zeros(1, np.int32)  # changes with each call
        self._lock, self._threads = Lock(), 0

    def help_with(self, call: _Call, threads: int) -> None:
        with self._lock:
            while self._threads < threads:
                Thread(target=self._run, name="team", daemon=True).start()
                self._threads += 1
        for _ in range(threads):
            self._calls.put(call)
        self._bell += 1

    def _run(self) -> None:
        flag = np.zeros(1, np.int32)
        while True:
            before = int(self._bell[0])
            if self._calls.empty():
                # the flag is set without the GIL, which the caller needs as soon as it sees it
                if set_and_watch(flag, self._bell, before, SPINS, GRACE):
                    continue
            else:
                flag[0] = 1
            flag = self._calls.get().take_parts()


@cache
def _pool() -> _Pool:
    return _Pool()


ALONE = ThreadTeam(1)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a fork takes no threads along

"""Threads that share the work on one image, for stages whose compiled code runs without Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from airline.kernels.atomics import all_set, set_and_watch

T = TypeVar("T")
MOST = 4  # the work takes a few milliseconds: more threads cost more than they do
LOOKS = 2000  # for the next piece of work, or for its end; some hundred nanoseconds each
GRACE = 10  # looks until who hands work over has begun its own part, and with that lets go of Python's lock


class Team:
    """Does a piece of work in as many parts as it has threads, the caller's included.

    Args:
        threads: how many; 1 does everything in the caller's thread.
    """

    def __init__(self, threads: int) -> None:
        self.threads = max(1, min(threads, MOST))

    def share(self, count: int, least: int, work: Callable[[int, int], T]) -> list[T]:
        """Call `work(start, end)` for parts that make up `range(count)`; the answers, in order.

        Args:
            count: of what there is to do.
            least: parts are not smaller than this: handing one over takes some 20 microseconds.
            work: must not depend on how the range is divided.
        """
        parts = max(1, min(self.threads, count // least))
        if parts == 1:
            return [work(0, count)]
        call = _Call(work, [count * part // parts for part in range(parts + 1)])
        _helpers().help_with(call, parts - 1)
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

    def take_part(self) -> NDArray[np.int32]:
        """Do parts until none is left: the caller does those that no helper has time for.

        Returns:
            (1,) of which the setting to 1 tells the caller that all of ours are done.
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
        self.take_part()[0] = 1
        if not all_set(self._done, LOOKS):
            for _ in self._answers:
                self._ends.get()
        if self._errors:
            raise self._errors[0]
        return self._answers


@dataclass
class _Helpers:
    """Threads that take part in calls; they end with the program."""

    calls: SimpleQueue[_Call] = field(default_factory=SimpleQueue)
    bell: NDArray[np.int32] = field(default_factory=lambda: np.zeros(1, np.int32))  # changes with each call
    lock: Lock = field(default_factory=Lock)
    threads: int = 0

    def help_with(self, call: _Call, parts: int) -> None:
        with self.lock:
            while self.threads < parts:
                Thread(target=self._help, name="team", daemon=True).start()
                self.threads += 1
        for _ in range(parts):
            self.calls.put(call)
        self.bell += 1

    def _help(self) -> None:
        flag = np.zeros(1, np.int32)
        while True:
            before = int(self.bell[0])
            if self.calls.empty():
                # the flag is set without Python's lock, which the caller needs as soon as it sees it
                if set_and_watch(flag, self.bell, before, LOOKS, GRACE):
                    continue
            else:
                flag[0] = 1
            flag = self.calls.get().take_part()


def cores() -> int:
    """How many cores this process may use: AIRLINE_CORES of the environment, or those that the system leaves it."""
    given = os.environ.get("AIRLINE_CORES", "")
    if given.isdecimal() and int(given):
        return int(given)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _helpers() -> _Helpers:
    return _Helpers()


ALONE = Team(1)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # a fork takes no threads along

"""Threads that share the work on one image, for stages whose compiled code runs without Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, TypeVar

T = TypeVar("T")
MOST = 4  # the work takes a few milliseconds: more threads cost more than they do


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
            least: parts are not smaller than this: handing one over takes some 50 microseconds (with futures, 120).
            work: must not depend on how the range is divided.
        """
        parts = max(1, min(self.threads, count // least))
        bounds = [count * part // parts for part in range(parts + 1)]
        if parts == 1:
            return [work(0, count)]
        todo: SimpleQueue[tuple[int, int]] = SimpleQueue()
        for start, end in pairwise(bounds):
            todo.put((start, end))
        answers: SimpleQueue[tuple[int, Any, BaseException | None]] = SimpleQueue()
        for _ in range(1, parts):
            _helpers().put((work, todo, answers))
        _work(work, todo, answers)
        done = {}
        for _ in range(parts):
            start, answer, error = answers.get()
            if error is not None:
                raise error
            done[start] = answer
        return [done[start] for start in bounds[:-1]]


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _helpers() -> SimpleQueue[tuple[Any, ...]]:
    """What is put here, `MOST` - 1 threads do; they end with the program."""
    calls: SimpleQueue[tuple[Any, ...]] = SimpleQueue()
    for _ in range(MOST - 1):
        Thread(target=_help, args=(calls,), name="team", daemon=True).start()
    return calls


def _help(calls: SimpleQueue[tuple[Any, ...]]) -> None:
    while True:
        _work(*calls.get())


def _work(
    work: Callable[[int, int], Any],
    todo: SimpleQueue[tuple[int, int]],
    answers: SimpleQueue[tuple[int, Any, BaseException | None]],
) -> None:
    """Do parts until none is left: the caller does those that no helper has time for."""
    while True:
        try:
            start, end = todo.get_nowait()
        except Empty:
            return
        try:
            answers.put((start, work(start, end), None))
        except BaseException as error:
            answers.put((start, None, error))


ALONE = Team(1)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # a fork takes no threads along

"""Threads that share the work on one image, for stages whose compiled code runs without Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

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
            least: parts are not smaller than this: handing one over takes some 50 microseconds.
            work: must not depend on how the range is divided.
        """
        parts = max(1, min(self.threads, count // least))
        bounds = [count * part // parts for part in range(parts + 1)]
        others = [_pool().submit(work, *bounds[part : part + 2]) for part in range(1, parts)]
        return [work(0, bounds[1]), *(other.result() for other in others)]


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(MOST - 1, "team")


ALONE = Team(1)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a fork takes no threads along

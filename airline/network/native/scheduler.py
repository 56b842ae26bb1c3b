"""Threads that go through the phases of a piece of work in compiled code, and wait for no one to start.

Each phase needs the one before, and has parts. Whoever comes takes parts that nobody has: thread k of n begins with the
k-th share of a phase, so that it finds in its cache what it made itself, and then helps the others. A phase is over
when all its parts are done; a thread that comes late finds nothing left to do.

`marks` are (phases, parts + 1) int32, zeros at first: of each phase how many parts are done, and whether each is taken.
"""

from __future__ import annotations

from airline.kernels.atomics import atomic_add, atomic_exchange, atomic_load, sched_yield
from airline.kernels.compiled import njit

PATIENCE = 2000  # spins before other programs may have the core


@njit(inline="always")
def bounds(marks, rows, unit, part):  # type: ignore[no-untyped-def]
    """First and last + 1 of the rows of a part; parts begin at multiples of `unit`, and may be empty."""
    parts, units = marks.shape[1] - 1, -(-rows // unit)
    return units * part // parts * unit, min(units * (part + 1) // parts * unit, rows)


@njit(inline="always")
def next_part(marks, phase, turn, who, threads):  # type: ignore[no-untyped-def]
    """The part that thread `who` of so many comes to in its `turn`, if it is ours now; else -1."""
    parts = marks.shape[1] - 1
    part = (turn + who * parts // threads) % parts
    return part if atomic_exchange(marks[phase, part + 1 :].ctypes.data, 1) == 0 else -1


@njit(inline="always")
def finish(marks, phase):  # type: ignore[no-untyped-def]
    """A part of ours is done."""
    atomic_add(marks[phase:].ctypes.data, 1)


@njit(inline="always")
def wait(marks, phase):  # type: ignore[no-untyped-def]
    """Until all parts of a phase are done."""
    address, spins = marks[phase:].ctypes.data, 0
    while atomic_load(address) < marks.shape[1] - 1:
        spins += 1
        if spins > PATIENCE:
            sched_yield()

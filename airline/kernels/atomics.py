"""Atomic operations on int32 in compiled code, waiting that spins instead of sleeping, and work in phases.

Waking a thread that sleeps takes 50 to 300 microseconds, a tenth of the time for an image: so threads spin, and yield
the core each time.

Threads go through the phases of a piece of work, and wait for no one to start. Each phase needs the one before, and has
parts. Thread k of n begins with the k-th share of a phase, so that it finds in its cache what it made itself, and then
helps the others; one that comes late finds nothing left to do. `marks` are (phases, parts + 1) int32, zeros at first:
of each phase how many parts are done, and whether each is taken.
"""

from __future__ import annotations

import os
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.extending import intrinsic as numba_intrinsic

from airline.kernels.compiled import njit

PATIENCE = 2000  # spins before other programs may have the core


intrinsic: Any = numba_intrinsic  # its type would be that of the emitting function, not of what numba makes of it

_I32 = ir.IntType(32)


def _pointer(builder: Any, address: Any) -> Any:
    return builder.inttoptr(address, _I32.as_pointer())


@intrinsic
def atomic_exchange(context, address, value):  # type: ignore[no-untyped-def]
    """Write an int32 to an address; returns what was there."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.atomic_rmw("xchg", _pointer(builder, arguments[0]), arguments[1], "seq_cst")

    return types.int32(types.int64, types.int32), emit


@intrinsic
def atomic_add(context, address, value):  # type: ignore[no-untyped-def]
    """Add to the int32 at an address; returns what was there."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.atomic_rmw("add", _pointer(builder, arguments[0]), arguments[1], "seq_cst")

    return types.int32(types.int64, types.int32), emit


@intrinsic
def atomic_load(context, address):  # type: ignore[no-untyped-def]
    """The int32 at an address."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.load_atomic(_pointer(builder, arguments[0]), "seq_cst", 4)

    return types.int32(types.int64), emit


@intrinsic
def sched_yield(context):  # type: ignore[no-untyped-def]
    """Let other threads have the core, where the system is POSIX."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        if os.name == "posix":
            name, module = "sched_yield", builder.module
            builder.call(module.globals.get(name) or ir.Function(module, ir.FunctionType(_I32, []), name), [])
        return context.get_dummy_value()

    return types.void(), emit


@njit()
def wait_for_all(flags, spins):  # type: ignore[no-untyped-def]
    """Whether all of (N,) int32 flags are set before we have spun so often."""
    flag, address = 0, flags.ctypes.data
    while flag < len(flags) and spins > 0:
        if atomic_load(address + 4 * flag):
            flag += 1
        else:
            spins -= 1
            sched_yield()
    return flag == len(flags)


@njit()
def set_and_watch(flag, number, before, spins, grace):  # type: ignore[no-untyped-def]
    """Set a flag; then whether a number, `before` so far, changes within so many spins; both (1,) int32.

    Where it changes, we go on for `grace` spins.
    """
    atomic_add(flag.ctypes.data, 1)
    address = number.ctypes.data
    while atomic_load(address) == before and spins > 0:
        spins -= 1
        sched_yield()
    for _ in range(grace if spins else 0):
        sched_yield()
    return spins > 0


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

"""Threads that go through the phases of a piece of work in compiled code, and wait for no one to start.

Each phase needs the one before, and has parts. Whoever comes takes parts that nobody has: thread k of n begins with the
k-th share of a phase, so that it finds in its cache what it made itself, and then helps the others. A phase is over
when all its parts are done; a thread that comes late finds nothing left to do.

The marks are int32, zeros at first: for each phase how many parts are done, then for each part whether it is taken.
"""

from __future__ import annotations

import os
from typing import Any

from llvmlite import ir
from numba.core import types

from airline.compiled import njit
from airline.runtimes.native.vectors import I32, intrinsic

PATIENCE = 2000  # looks at what is not done yet, before other programs may have the core


def _pointer(builder: Any, address: Any) -> Any:
    return builder.inttoptr(address, I32.as_pointer())


@intrinsic
def _swap_in_one(context, address):  # type: ignore[no-untyped-def]
    """Write 1 and answer what was there, in one step."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.atomic_rmw("xchg", _pointer(builder, arguments[0]), I32(1), "seq_cst")

    return types.int32(types.int64), emit


@intrinsic
def _add_one(context, address):  # type: ignore[no-untyped-def]
    """In one step."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        builder.atomic_rmw("add", _pointer(builder, arguments[0]), I32(1), "seq_cst")
        return context.get_dummy_value()

    return types.void(types.int64), emit


@intrinsic
def _look(context, address):  # type: ignore[no-untyped-def]
    """What other threads have written."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.load_atomic(_pointer(builder, arguments[0]), "seq_cst", 4)

    return types.int32(types.int64), emit


@intrinsic
def _let_others_run(context):  # type: ignore[no-untyped-def]
    """Where the system offers that."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        if os.name == "posix":
            name, module = "sched_yield", builder.module
            builder.call(module.globals.get(name) or ir.Function(module, ir.FunctionType(I32, []), name), [])
        return context.get_dummy_value()

    return types.void(), emit


@njit()
def bounds(marks, rows, unit, part):  # type: ignore[no-untyped-def]
    """First and last + 1 of the rows of a part; parts begin at multiples of `unit`, and may be empty."""
    parts, units = marks.shape[1] - 1, -(-rows // unit)
    return units * part // parts * unit, min(units * (part + 1) // parts * unit, rows)


@njit()
def next_part(marks, phase, turn, who, crew):  # type: ignore[no-untyped-def]
    """The part that thread `who` of `crew` comes to in its `turn`, if it is ours now; else -1."""
    parts = marks.shape[1] - 1
    part = (turn + who * parts // crew) % parts
    return part if _swap_in_one(marks[phase, part + 1 :].ctypes.data) == 0 else -1


@njit()
def finish(marks, phase):  # type: ignore[no-untyped-def]
    """A part of ours is done."""
    _add_one(marks[phase:].ctypes.data)


@njit()
def wait(marks, phase):  # type: ignore[no-untyped-def]
    """Until all parts of a phase are done."""
    address, looks = marks[phase:].ctypes.data, 0
    while _look(address) < marks.shape[1] - 1:
        looks += 1
        if looks > PATIENCE:
            _let_others_run()

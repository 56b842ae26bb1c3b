"""Steps that threads of compiled code cannot get between, and waiting that does not sleep.

A thread that the system has put to sleep takes 50 to 300 microseconds to wake up, a tenth of the time for an image. For
as long as the next piece of work is likely to come, threads look for it instead, and let others have the core each
time.
"""

from __future__ import annotations

import os
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.extending import intrinsic as numba_intrinsic

from airline.kernels.compiled import njit

intrinsic: Any = numba_intrinsic  # its type would be that of the emitting function, not of what numba makes of it

_I32 = ir.IntType(32)


def _pointer(builder: Any, address: Any) -> Any:
    return builder.inttoptr(address, _I32.as_pointer())


@intrinsic
def swap_in_one(context, address):  # type: ignore[no-untyped-def]
    """Write 1 to an int32 and answer what was there, in one step."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.atomic_rmw("xchg", _pointer(builder, arguments[0]), _I32(1), "seq_cst")

    return types.int32(types.int64), emit


@intrinsic
def add_one(context, address):  # type: ignore[no-untyped-def]
    """To an int32, in one step."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        builder.atomic_rmw("add", _pointer(builder, arguments[0]), _I32(1), "seq_cst")
        return context.get_dummy_value()

    return types.void(types.int64), emit


@intrinsic
def look(context, address):  # type: ignore[no-untyped-def]
    """What an int32 is, whoever wrote it."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.load_atomic(_pointer(builder, arguments[0]), "seq_cst", 4)

    return types.int32(types.int64), emit


@intrinsic
def let_others_run(context):  # type: ignore[no-untyped-def]
    """Where the system offers that."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        if os.name == "posix":
            name, module = "sched_yield", builder.module
            builder.call(module.globals.get(name) or ir.Function(module, ir.FunctionType(_I32, []), name), [])
        return context.get_dummy_value()

    return types.void(), emit


@njit()
def all_set(flags, looks):  # type: ignore[no-untyped-def]
    """Whether all of some int32 flags are set before we have looked so often."""
    flag, address = 0, flags.ctypes.data
    while flag < len(flags) and looks > 0:
        if look(address + 4 * flag):
            flag += 1
        else:
            looks -= 1
            let_others_run()
    return flag == len(flags)


@njit()
def set_and_watch(flag, number, before, looks, grace):  # type: ignore[no-untyped-def]
    """Set a flag; then tell whether a number becomes another before we have looked so often.

    Both are the first int32 of an array. Where the number changes, we wait for as long as `grace` more looks take.
    """
    add_one(flag.ctypes.data)
    address = number.ctypes.data
    while look(address) == before and looks > 0:
        looks -= 1
        let_others_run()
    for _ in range(grace if looks else 0):
        let_others_run()
    return looks > 0

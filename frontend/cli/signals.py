"""Being told to end: SIGTERM and SIGHUP end a command as Ctrl-C does, with complete files."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

EXIT_INTERRUPTED = 130
_NAMES = ("SIGTERM", "SIGHUP")  # of a service manager or `kill`; of a terminal or an ssh session that is closed


class Terminated(KeyboardInterrupt):
    """One of the signals has come."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.code = 128 + number


class _Interrupts:
    """What the handlers of a process and `uninterrupted` know of each other."""

    told = False  # to end, for the first time or again
    busy = False
    held: KeyboardInterrupt | None = None

    def take(self, interrupt: KeyboardInterrupt) -> None:
        """Raise the interrupt, or hold it if it is the first and comes within `uninterrupted`."""
        first, self.told = not self.told, True
        if not (first and self.busy):
            raise interrupt
        self.held = interrupt


_interrupts = _Interrupts()


@contextmanager
def ending_like_interrupts() -> Iterator[None]:
    """Inside the block the first of these signals raises `Terminated`; more of them do not disturb the end.

    `uninterrupted` can make it, and Ctrl-C, wait. Signals that somebody ignores or handles are left alone.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual: dict[int, Any] = {getattr(signal, name): signal.SIG_DFL for name in _NAMES if hasattr(signal, name)}
    usual[signal.SIGINT] = signal.default_int_handler
    ours = [number for number, handler in usual.items() if signal.getsignal(number) == handler]

    def end(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGINT:
            _interrupts.take(KeyboardInterrupt())
            return
        for other in ours:
            if other != signal.SIGINT:
                signal.signal(other, signal.SIG_IGN)
        _interrupts.take(Terminated(number))

    _interrupts.told = False
    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, usual[number])


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Work that must not be left half done, such as writing a frame: the first interrupt is raised at its end.

    The second Ctrl-C is raised at once. Only within `ending_like_interrupts`, and of no effect outside; blocks do not
    nest. An error of the work goes before the interrupt.
    """
    _interrupts.busy = True
    try:
        yield
    finally:
        _interrupts.busy = False
        held, _interrupts.held = _interrupts.held, None
    if held is not None:
        raise held


def exit_code_of(interrupt: KeyboardInterrupt) -> int:
    """What a shell expects: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP."""
    return interrupt.code if isinstance(interrupt, Terminated) else EXIT_INTERRUPTED


def ignore_more(code: int) -> None:
    """Before a process ends with such a code: told again while Python shuts down, it would be killed."""
    for name in _NAMES:
        if hasattr(signal, name) and code == 128 + getattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)

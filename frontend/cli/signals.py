"""Being told to end: SIGTERM and SIGHUP end a command as Ctrl-C does, with complete files."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_INTERRUPTED = 130
_NAMES = ("SIGTERM", "SIGHUP")  # of a service manager or `kill`; of a terminal or an ssh session that is closed


class Terminated(KeyboardInterrupt):
    """One of the signals has come."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.code = 128 + number


class _Interrupts:
    """What the handlers of a process and `uninterrupted` know of each other."""

    def __init__(self) -> None:
        self.told = False  # to end, for the first time or again
        self.busy = False
        self.held: KeyboardInterrupt | None = None

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
    numbers = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    ours = [number for number in numbers if signal.getsignal(number) == signal.SIG_DFL]

    def end(number: int, frame: FrameType | None) -> None:
        for each in ours:
            signal.signal(each, signal.SIG_IGN)
        _interrupts.take(Terminated(number))

    def interrupt(number: int, frame: FrameType | None) -> None:
        _interrupts.take(KeyboardInterrupt())

    ctrl_c = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    _interrupts.told = False
    for number in ours:
        signal.signal(number, end)
    if ctrl_c:
        signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        if ctrl_c:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


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

"""Being told to end: SIGTERM and SIGHUP end a command as Ctrl-C does, with complete files."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

EXIT_INTERRUPTED = 130
_NAMES = ("SIGTERM", "SIGHUP")  # of a service manager or `kill`; of a terminal or an ssh session that is closed


class Terminated(KeyboardInterrupt):
    """One of the signals has come."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.code = 128 + number


@contextmanager
def ending_like_interrupts() -> Iterator[None]:
    """Inside the block the first of these signals raises `Terminated`; more of them do not disturb the end.

    Signals that somebody ignores or handles are left alone.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    ours = [number for number in numbers if signal.getsignal(number) == signal.SIG_DFL]

    def end(number: int, frame: object) -> None:
        for each in ours:
            signal.signal(each, signal.SIG_IGN)
        raise Terminated(number)

    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def exit_code_of(interrupt: KeyboardInterrupt) -> int:
    """What a shell expects: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP."""
    return interrupt.code if isinstance(interrupt, Terminated) else EXIT_INTERRUPTED

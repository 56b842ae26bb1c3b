"""A pipe as FFmpeg reads it."""

from __future__ import annotations

import select
import threading

from airline.errors import InputError
from frontend.sources import kinds

_POLL_S = 0.2


class Pipe:
    """A pipe whose beginning may be looked at: `stopped` ends it, from any thread, and so does Ctrl-C.

    Attributes:
        start: what it begins with, enough for `kinds.kind_of_content`.
        interrupt: the Ctrl-C that has ended it: no exception passes through FFmpeg.

    Raises:
        InputError: it cannot be read.
    """

    def __init__(self, path: str) -> None:
        self.stopped = threading.Event()
        self.interrupt: KeyboardInterrupt | None = None
        try:
            self._file = open(path, "rb", buffering=0)  # noqa: PTH123, SIM115  closed with the pipe
        except OSError as error:
            raise InputError(f"cannot read from '{path}': {error.strerror}") from None
        self.start = self._ahead = kinds.start_from(self._take)

    def read(self, size: int) -> bytes:
        try:
            if self._ahead:
                data, self._ahead = self._ahead[:size], self._ahead[size:]
                return data
            return self._take(size)
        except KeyboardInterrupt as interrupt:
            self.interrupt = interrupt
            return b""

    def close(self) -> None:
        self._file.close()

    def _take(self, size: int) -> bytes:
        """What there is, up to so many bytes, as soon as there is any; none at the end."""
        while not self.stopped.is_set():
            if select.select([self._file], [], [], _POLL_S)[0]:
                return self._file.read(size) or b""
        return b""

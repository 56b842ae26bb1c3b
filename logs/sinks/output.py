"""Files to write: never over others unasked, and with errors that name the file."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from airline.errors import InputError

FLUSH_S = 1.0  # at most so much of the stream is lost when the process is killed


@contextmanager
def errors_of(path: Path) -> Iterator[None]:
    """Turn the system's errors inside the block, such as a full disk, into an `InputError` that names the file."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from error


def check_new(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, a file that exists or that cannot be made; raises InputError."""
    if not os.path.isdir(path.parent):  # noqa: PTH112 (pathlib's raises where the parent is inside a file)
        raise InputError(f"cannot write '{path}': there is no folder '{path.parent}'")
    if path.is_dir():
        raise InputError(f"cannot write '{path}': it is a folder")
    if path.exists() and not overwrite:
        raise InputError(f"'{path}' exists: choose another name or give --overwrite")


class OutputFile:
    """A new file that is written to until the first error, which closes it: what stands before a gap stays readable.

    Args:
        path: the file.
        overwrite: replace an existing file.

    Raises:
        InputError: the file exists or cannot be written.
    """

    def __init__(self, path: Path, overwrite: bool) -> None:
        check_new(path, overwrite)
        self.path = path
        with errors_of(path):
            self.file: BinaryIO = path.open("wb" if overwrite else "xb")
        self.is_open = True
        self._checked = time.monotonic()

    @contextmanager
    def writing(self) -> Iterator[BinaryIO]:
        """The file, to write to inside the block; raises InputError when that fails, and ever after."""
        if not self.is_open:
            raise InputError(f"cannot write '{self.path}': it is closed")
        try:
            with errors_of(self.path):
                if time.monotonic() - self._checked >= FLUSH_S:
                    self._check_place()
                yield self.file
        except InputError:
            self.is_open = False
            with suppress(OSError):  # closing tries once more to write what could not be written
                self.file.close()
            raise

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self.is_open:
            with self.writing() as file:
                self._check_place()
                file.close()
            self.is_open = False

    def _check_place(self) -> None:
        """Refuse to go on with a file that nobody could find; raises InputError."""
        self._checked = time.monotonic()
        if not is_at(self.file.fileno(), self.path):
            raise InputError(
                f"cannot write '{self.path}': it was removed or moved while it was written; leave it in its place"
            )


def is_at(descriptor: int, path: Path) -> bool:
    """Whether an open file still has its name; raises OSError where that cannot be told."""
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except (FileNotFoundError, NotADirectoryError):
        return False

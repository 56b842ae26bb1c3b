"""Files to write: never over others unasked, whole lines and messages every second, errors that name the file."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mcap.writer import Writer

from airline.errors import InputError, errors_of

LIMAP_FILES = ("images.csv", "cameras.txt", "metainfos.txt")  # at the top of a LIMAP folder
FLUSH_S = 1.0  # at most so much of the stream is lost when the process is killed


def check_new(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, a file that exists or that cannot be made; raises InputError."""
    if not os.path.isdir(path.parent):  # noqa: PTH112 (pathlib's raises where the parent is inside a file)
        raise InputError(f"cannot write '{path}': there is no folder '{path.parent}'")
    if path.is_dir():
        raise InputError(f"cannot write '{path}': it is a folder")
    if path.exists() and not overwrite:
        raise InputError(f"'{path}' exists: choose another name or give --overwrite")


def journal_of(path: Path) -> Path:
    """Where the journal of a Parquet file lies."""
    return path.with_name(path.name + ".unfinished")


def check_table(path: Path, overwrite: bool) -> None:
    """The same for a Parquet file, and the journal of one."""
    check_new(path, overwrite)
    journal = journal_of(path)
    if journal.exists() and not overwrite:
        raise InputError(
            f"'{journal}' is left from a run that did not end: make '{path.name}' of it with "
            f"python -m logs.repair {journal}, or give --overwrite"
        )


def tables_of(path: Path) -> tuple[Path, Path]:
    """Where the list of frames of a CSV file lies, and that of its points."""
    name = path.stem if path.suffix.lower() == ".csv" else path.name
    return path.with_name(f"{name}.frames.csv"), path.with_name(f"{name}.points.csv")


def check_csv(path: Path, overwrite: bool) -> None:
    """The same for a CSV file, and the lists of its frames and points."""
    for new in (path, *tables_of(path)):
        check_new(new, overwrite)


def check_folder(folder: Path, overwrite: bool) -> None:
    """The same for LIMAP's folder, which may be there if it is empty; files that are not of such a run are kept."""
    if folder.is_dir():
        names = {path.name for path in folder.iterdir()}
        if names and not overwrite:
            raise InputError(f"'{folder}' holds files: choose an empty folder or give --overwrite")
        if "line_detections" not in names:
            for name in names.intersection(LIMAP_FILES):
                raise InputError(f"'{folder}' holds a {name} that is of something else: choose another folder")
    elif folder.exists() or not os.path.isdir(folder.parent):  # noqa: PTH112
        raise InputError(f"cannot make the folder '{folder}': give a name in a folder that exists")


@contextmanager
def whole_file(path: Path, part: Path | None = None) -> Iterator[BinaryIO]:
    """A file that appears, or replaces another, when the block ends well; until then it is `part`, hidden beside it."""
    part = part or path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with part.open("wb") as file:
            yield file
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


class OutputFile:
    """A new file that is written to until the first error, which closes it: what stands before a gap stays readable.

    Raises:
        InputError: the file exists and `overwrite` is not set, or it cannot be written.
    """

    def __init__(self, path: Path, overwrite: bool) -> None:
        check_new(path, overwrite)
        self.path = path
        with errors_of(path):
            self.file: BinaryIO = path.open("wb" if overwrite else "xb")
        self.is_open = True
        self._checked = self._flushed = time.monotonic()

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

    def flush_is_due(self) -> bool:
        """Whether `FLUSH_S` have passed since it was due last."""
        due = time.monotonic() - self._flushed >= FLUSH_S
        if due:
            self._flushed = time.monotonic()
        return due

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self.is_open:
            with self.writing() as file:
                self._check_place()
                file.close()
            self.is_open = False

    def _check_place(self) -> None:
        self._checked = time.monotonic()
        try:
            is_there = os.path.samestat(self.path.stat(), os.fstat(self.file.fileno()))
        except (FileNotFoundError, NotADirectoryError):
            is_there = False
        if not is_there:
            raise InputError(
                f"cannot write '{self.path}': it was removed or moved while it was written; leave it in its place"
            )


class McapOutput(OutputFile):
    """An MCAP file whose chunks are closed by the clock: all but the last second can be read, whatever happens.

    Args:
        path, overwrite: see `OutputFile`.
        metadata: the record "airline-frontend"; written first, so that a cut file has it too.
        profile: MCAP's name for the kind of system the messages are from, such as "ros1".
    """

    def __init__(self, path: Path, overwrite: bool, metadata: Mapping[str, str], *, profile: str = "") -> None:
        super().__init__(path, overwrite)
        self._sequences: Counter[int] = Counter()  # messages so far by channel: zero would mean that nobody counts
        self._writer = Writer(self.file)
        with self.writing():
            self._writer.start(profile=profile, library="airline-frontend")
            self._writer.add_metadata("airline-frontend", dict(metadata))
            self._writer.flush()

    def channel(self, topic: str, encoding: str, schema_name: str, schema_encoding: str, schema: bytes) -> int:
        """Announce a topic; returns the number to write its messages with."""
        with self.writing():
            schema_id = self._writer.register_schema(schema_name, schema_encoding, schema)
            return self._writer.register_channel(topic, encoding, schema_id)

    def write(self, channel: int, stamp_ns: int, data: bytes) -> None:
        """Add a message, the next of its channel; players order and show messages by the stamp, ns."""
        if not 0 <= stamp_ns < 2**63:
            raise InputError(f"cannot write '{self.path}': MCAP has no time {stamp_ns} ns, before the epoch")
        self._sequences[channel] += 1
        with self.writing():
            self._writer.add_message(channel, stamp_ns, data, stamp_ns, self._sequences[channel])

    def flush_when_due(self) -> None:
        """Close the chunk when the last one was closed a second ago; call it when a frame is complete."""
        if self.flush_is_due():
            with self.writing():
                self._writer.flush()

    def close(self) -> None:
        """Write the index and close the file; safe to call twice."""
        if self.is_open:
            with self.writing():
                self._writer.finish()
            super().close()

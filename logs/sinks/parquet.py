"""Tracked lines in a Parquet file, for notebooks and for reading back."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from airline.errors import InputError
from frontend.protocols import FrameResult
from logs.sinks.output import FLUSH_S, OutputFile, check_new, errors_of
from logs.tracks.journal import JournalWriter, journal_of, read_journal
from logs.tracks.table import SCHEMA, TableNotes

_ROWS_WAITING = 50_000  # at most, 10 MB
_GROUP_ROWS = 100_000  # 20 MB


class ParquetTrackSink:
    """Writes each frame's tracks into a Parquet file, one row per observation; a `Sink`.

    The columns, their units and the conventions are in `logs.tracks.table` and in the file's own metadata. While it
    runs, rows go into the journal `NAME.parquet.unfinished`, at least every second; `close` makes the Parquet file of
    it. After a crash `finish_journal` does, and `logs.read_tracks` reads the journal as it is.

    Args:
        path: the file.
        overwrite: replace an existing file, and the journal of a run that never ended.

    Raises:
        InputError: the file exists or cannot be written; what was written until then stays in the journal.
    """

    def __init__(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        self._path = Path(path)
        self._journal = journal_of(self._path)
        self._overwrite = overwrite
        check_table(self._path, overwrite)
        self._output = OutputFile(self._journal, overwrite)
        with self._output.writing() as file:
            self._writer = JournalWriter(file)
        self._flushed = time.monotonic()

    def write(self, result: FrameResult) -> None:
        """Add one frame's tracks."""
        self._writer.add(result.tracks)
        now = time.monotonic()
        if now - self._flushed >= FLUSH_S or self._writer.rows_waiting >= _ROWS_WAITING:
            with self._output.writing():
                self._writer.flush()
            self._flushed = now

    def close(self) -> None:
        """Make the Parquet file; safe to call twice."""
        if not self._output.is_open:
            return
        with self._output.writing():
            self._writer.close()
        self._output.close()
        try:
            finish_journal(self._journal, self._path, overwrite=self._overwrite)
        except InputError as error:
            if not self._journal.exists():
                raise
            raise InputError(f"{error}; the tracks are in '{self._journal}', for python -m logs.repair") from error


def check_table(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, an output that exists, or the journal of one; raises InputError."""
    check_new(path, overwrite)
    journal = journal_of(path)
    if journal.exists() and not overwrite:
        raise InputError(
            f"'{journal}' is left from a run that did not end: make '{path.name}' of it with "
            f"python -m logs.repair {journal}, or give --overwrite"
        )


def finish_journal(path: Path, out: Path, overwrite: bool = False) -> int:
    """Make a Parquet file of a journal, in bounded memory, and remove the journal.

    Args:
        path: the journal, which may be cut anywhere: all whole batches are used.
        out: the Parquet file; it appears when it is complete.
        overwrite: replace an existing file.

    Returns:
        How many rows the file has.

    Raises:
        InputError: a file that is no journal, or an output that exists or cannot be written; the journal stays.
    """
    check_new(out, overwrite)
    unfinished = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        with errors_of(out), unfinished.open("xb") as file:
            rows = _write_table(path, pa.PythonFile(file, "w"))
        check_new(out, overwrite)
        with errors_of(out):
            unfinished.replace(out)
            path.unlink()
    finally:
        unfinished.unlink(missing_ok=True)
    return rows


def _write_table(journal: Path, file: pa.NativeFile) -> int:
    notes = TableNotes()
    rows = 0
    group: list[pa.RecordBatch] = []
    options = {"compression": "zstd", "write_page_checksum": True}
    with pq.ParquetWriter(file, SCHEMA, **options) as writer:
        for batch in read_journal(journal, notes):
            group.append(batch)
            if sum(map(len, group)) >= _GROUP_ROWS:
                rows += _write_group(writer, group)
        rows += _write_group(writer, group)
        writer.add_key_value_metadata(notes.to_metadata())
    return rows


def _write_group(writer: pq.ParquetWriter, group: list[pa.RecordBatch]) -> int:
    table = pa.Table.from_batches(group, SCHEMA)
    if len(table):
        writer.write_table(table, row_group_size=max(_GROUP_ROWS, len(table)))
    group.clear()
    return len(table)

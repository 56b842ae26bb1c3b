"""Tracked lines in a Parquet file, for notebooks and for reading back.

A Parquet file has its index at the end and is nothing without it. So rows go into a journal first, an Arrow IPC stream
that is readable up to its last whole batch. Every batch holds whole frames, and in its metadata the notes on them.
"""

from __future__ import annotations

import os
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from airline.errors import InputError
from frontend.camera.model import CameraModel
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from logs.read import read_journal
from logs.sinks.output import OutputFile, check_new, errors_of, whole_file
from logs.tracks.json import Camera
from logs.tracks.table import SCHEMA, TableNotes, to_batch

_ROWS_WAITING = 50_000  # at most, 10 MB
_GROUP_ROWS = 100_000  # 20 MB


class ParquetTrackSink:
    """Writes each frame's tracks into a Parquet file, one row per observation; a `Sink`.

    The file's own metadata explain its columns. While it runs, rows go into the journal `NAME.parquet.unfinished`, at
    least every second; `close` makes the Parquet file of it. After a crash `finish_journal` does, and
    `logs.read_tracks` reads the journal as it is. Arguments and errors are those of `OutputFile`.
    """

    def __init__(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        self._path = Path(path)
        self._overwrite = overwrite
        check_table(self._path, overwrite)
        self._output = OutputFile(journal_of(self._path), overwrite)
        self._frames: list[LineTracks] = []
        self._notes = TableNotes()
        self._place = 0
        self._camera: CameraModel | None = None
        with self._output.writing() as file:
            self._stream = pa.ipc.new_stream(file, SCHEMA)
            self._write_batch()  # the header is on its way with the first batch only

    def write(self, result: FrameResult) -> None:
        """Add one frame's tracks."""
        tracks = result.tracks
        if tracks.camera is not self._camera and Camera.of(tracks.camera) != Camera.of(self._camera):
            self._notes.cameras[self._place] = tracks.camera
        self._camera = tracks.camera
        if not len(tracks):
            self._notes.empty[self._place] = tracks
        self._frames.append(tracks)
        self._place += 1
        if self._output.flush_is_due() or sum(map(len, self._frames)) >= _ROWS_WAITING:
            self.flush()

    def flush(self) -> None:
        """Write what is waiting into the journal; whatever happens to the process, it can be read from now on."""
        if self._frames:
            with self._output.writing():
                self._write_batch()

    def close(self) -> None:
        """Make the Parquet file; safe to call twice."""
        if not self._output.is_open:
            return
        self.flush()
        with self._output.writing():
            self._stream.close()
        self._output.close()
        try:
            finish_journal(self._output.path, self._path, overwrite=self._overwrite)
        except InputError as error:
            if not self._output.path.exists():
                raise
            raise InputError(f"{error}; the tracks are in '{self._output.path}', for python -m logs.repair") from error

    def _write_batch(self) -> None:
        self._stream.write_batch(to_batch(self._frames), custom_metadata=self._notes.to_metadata())
        self._output.file.flush()
        self._frames, self._notes = [], TableNotes()


def journal_of(path: Path) -> Path:
    """Where the journal of a Parquet file lies."""
    return path.with_name(path.name + ".unfinished")


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
        InputError: no journal, or an output that exists or cannot be written; the journal stays.
    """
    check_new(out, overwrite)
    notes, rows = TableNotes(), 0
    group: list[pa.RecordBatch] = []
    options = {"compression": "zstd", "write_page_checksum": True}
    with errors_of(out):
        with whole_file(out) as file:
            with pq.ParquetWriter(pa.PythonFile(file, "w"), SCHEMA, **options) as writer:
                for batch in read_journal(path, notes):
                    group.append(batch)
                    if sum(map(len, group)) >= _GROUP_ROWS:
                        rows += _write_group(writer, group)
                rows += _write_group(writer, group)
                writer.add_key_value_metadata(notes.to_metadata())
            check_new(out, overwrite)
        path.unlink()
    return rows


def _write_group(writer: pq.ParquetWriter, group: list[pa.RecordBatch]) -> int:
    table = pa.Table.from_batches(group, SCHEMA)
    if len(table):
        writer.write_table(table, row_group_size=max(_GROUP_ROWS, len(table)))
    group.clear()
    return len(table)

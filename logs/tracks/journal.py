"""The journal of a table that is being written: an Arrow IPC stream, readable up to its last whole batch.

A Parquet file has its index at the end and is nothing without it; a journal loses no more than the batch in the making.
Every batch holds whole frames, and in its metadata the notes on them.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa

from airline.errors import InputError
from frontend.camera.model import CameraModel
from frontend.tracks import LineTracks
from logs.tracks.json import camera_fields
from logs.tracks.rows import check_columns
from logs.tracks.table import SCHEMA, TableNotes, to_batch

log = logging.getLogger(__name__)

SUFFIX = ".unfinished"
DAMAGE = (pa.ArrowException, OSError, MemoryError, ValueError)  # what pyarrow raises for damaged files


def journal_of(path: Path) -> Path:
    """Where the journal of a Parquet file lies."""
    return path.with_name(path.name + SUFFIX)


class JournalWriter:
    """Writes frames into a journal; OSError when that fails."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._stream = pa.ipc.new_stream(file, SCHEMA)
        self._frames: list[LineTracks] = []
        self._notes = TableNotes()
        self._place = 0
        self._camera: CameraModel | None = None
        self.rows_waiting = 0
        self._write()  # the header is on its way with the first batch only

    def add(self, tracks: LineTracks) -> None:
        """Take the next frame; `flush` writes it."""
        if tracks.camera is not self._camera and camera_fields(tracks.camera) != camera_fields(self._camera):
            self._notes.cameras[self._place] = tracks.camera
        self._camera = tracks.camera
        if not len(tracks):
            self._notes.empty[self._place] = tracks
        self._frames.append(tracks)
        self._place += 1
        self.rows_waiting += len(tracks)

    def flush(self) -> None:
        """Write what is waiting; whatever happens to the process, it can be read from now on."""
        if self._frames:
            self._write()

    def close(self) -> None:
        """Write the rest and the mark of the end."""
        self.flush()
        self._stream.close()
        self._file.flush()

    def _write(self) -> None:
        self._stream.write_batch(to_batch(self._frames), custom_metadata=self._notes.to_metadata())
        self._file.flush()
        self._frames, self._notes, self.rows_waiting = [], TableNotes(), 0


def read_journal(path: Path, notes: TableNotes) -> Iterator[pa.RecordBatch]:
    """The batches of a journal, up to where it was cut, with one warning if it was cut within a batch.

    Args:
        path: the journal; it may still be growing.
        notes: gathers the notes on a batch's frames before the batch is given out.

    Raises:
        InputError: a file that is no journal of ours.
    """
    try:
        with pa.memory_map(str(path)) as file:
            stream = pa.ipc.open_stream(file)
            check_columns(stream.schema)
            while True:
                try:
                    batch, metadata = stream.read_next_batch_with_custom_metadata()
                    batch.validate(full=True)
                except StopIteration:
                    return
                except DAMAGE:
                    log.warning("%s: the journal is cut or damaged; its readable part was used", path.name)
                    return
                notes.add(metadata)
                yield batch
    except DAMAGE as error:
        raise InputError(f"'{path}' is not a journal of tracks: {error}") from error

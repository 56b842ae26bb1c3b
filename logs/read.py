"""Tracked lines back from the files that the sinks wrote."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from airline.errors import InputError
from frontend.history import Confirmations
from frontend.tracks import LineTracks
from logs.files import MCAP_MAGIC
from logs.tracks.json import SCHEMA_NAME, decode_tracks
from logs.tracks.table import TableNotes, needed_columns, read_frames

log = logging.getLogger(__name__)

_DAMAGE = (pa.ArrowException, OSError, MemoryError, ValueError)  # what pyarrow raises for damaged files
_GROUP_BYTES = 1 << 30  # of a Parquet row group; ours have 22 MB
_BATCH_ROWS = 16_384


def read_tracks(path: str | os.PathLike[str]) -> Iterator[LineTracks]:
    """The tracks of every frame, as they were written; of a log or a journal that was cut, with one warning.

    Args:
        path: a file of `McapTrackSink` or `ParquetTrackSink`, or the `.parquet.unfinished` journal of the latter.

    Raises:
        InputError: a file that is none of these, or that was damaged; for some damage, in the middle of the iteration.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read tracks from '{path}': {error}") from error
    for magic, read in _KINDS.items():
        if start.startswith(magic):
            confirmations = Confirmations()
            return (confirmations.add(tracks) for tracks in read(path))
    raise InputError(f"cannot read tracks from '{path}': it is no MCAP or Parquet file with tracks, and no journal")


def read_journal(path: Path, notes: TableNotes) -> Iterator[pa.RecordBatch]:
    """The batches of a `ParquetTrackSink`'s journal, which may still be growing, up to where it was cut.

    `notes` gathers the notes on a batch's frames before it is given out. Raises InputError: no journal of ours.
    """
    try:
        with pa.memory_map(str(path)) as file:
            stream = pa.ipc.open_stream(file)
            needed_columns(stream.schema)
            while True:
                try:
                    batch, metadata = stream.read_next_batch_with_custom_metadata()
                    batch.validate(full=True)
                except StopIteration:
                    return
                except _DAMAGE:
                    log.warning("%s: the journal is cut or damaged; its readable part was used", path.name)
                    return
                notes.add(metadata)
                yield batch
    except _DAMAGE as error:
        raise InputError(f"'{path}' is not a journal of tracks: {error}") from error


def _read_mcap(path: Path) -> Iterator[LineTracks]:
    from logs.files.mcap_file import McapFile

    with closing(McapFile(path)) as file:
        topics = [name for name, topic in file.topics.items() if topic.type.schema_name == SCHEMA_NAME]
        if len(topics) != 1:
            held = ", ".join(f"{name} ({topic.type})" for name, topic in file.topics.items()) or "no messages"
            raise InputError(f"'{path}' has {len(topics)} topics of {SCHEMA_NAME}, not one: it holds {held}")
        for message in file.messages(topics[0]):
            try:
                yield decode_tracks(message.data)
            except InputError as error:
                raise InputError(f"'{path}': the message at {message.log_ns} ns is {error}") from error


def _read_parquet(path: Path) -> Iterator[LineTracks]:
    notes = TableNotes()
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            columns = needed_columns(file.schema_arrow)
            groups = [file.metadata.row_group(k) for k in range(file.num_row_groups)]
            if any(group.total_byte_size > _GROUP_BYTES for group in groups):
                raise InputError(f"a row group claims more than {_GROUP_BYTES} bytes")
            notes.add(file.metadata.metadata)
            batches = file.iter_batches(_BATCH_ROWS, columns=columns) if groups else ()  # pyarrow 18 stumbles over none
            yield from read_frames(batches, notes)
    except _DAMAGE as error:
        reason = " ".join(str(error).split())
        raise InputError(f"cannot read tracks from '{path}', it is no Parquet file or damaged: {reason}") from error
    except InputError as error:
        raise InputError(f"cannot read tracks from '{path}': {error}") from error


def _read_journal(path: Path) -> Iterator[LineTracks]:
    notes = TableNotes()
    try:
        yield from read_frames(read_journal(path, notes), notes)
    except InputError as error:
        raise InputError(f"cannot read tracks from '{path}': {error}") from error


_KINDS = {MCAP_MAGIC: _read_mcap, b"PAR1": _read_parquet, b"\xff\xff\xff\xff": _read_journal}

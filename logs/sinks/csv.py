"""Tracked lines as CSV, for people and spreadsheets."""

from __future__ import annotations

import os
from pathlib import Path

import pyarrow as pa
import pyarrow.csv

from airline.errors import InputError
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from logs.sinks.output import OutputFile
from logs.tracks.table import FRAME_COLUMNS, to_batch

_ROWS_WAITING = 50_000  # at most
_DESCRIPTOR_LENGTH = 6  # of a file without rows


class CsvTrackSink:
    """Writes each frame's tracks into a CSV file, one line per observation; a `Sink`.

    The columns are those of the Parquet file, with the descriptor as d0, d1, ... and without what belongs to a whole
    frame. Numbers have the shortest text that reads back as the same float32; an empty field means that there is none.
    Whole lines are written, at least every second.

    Arguments and errors are those of `OutputFile`.
    """

    def __init__(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        self._output = OutputFile(Path(path), overwrite)
        self._frames: list[LineTracks] = []
        self._descriptor_length: int | None = None
        self._header_written = False

    def write(self, result: FrameResult) -> None:
        """Add one frame's tracks."""
        tracks = result.tracks
        if not len(tracks):
            return
        length = tracks.descriptors.shape[1]
        if self._descriptor_length not in (None, length):
            raise InputError(
                f"'{self._output.path}' has columns for {self._descriptor_length} numbers of a descriptor, "
                f"but frame {tracks.frame_index} has {length}"
            )
        self._descriptor_length = length
        self._frames.append(tracks)
        if self._output.flush_is_due() or sum(map(len, self._frames)) >= _ROWS_WAITING:
            self._flush()

    def close(self) -> None:
        """Write the rest; safe to call twice."""
        if self._output.is_open:
            self._flush()
            self._output.close()

    def _flush(self) -> None:
        table = to_batch(self._frames)
        self._frames = []
        length = _DESCRIPTOR_LENGTH if self._descriptor_length is None else self._descriptor_length
        descriptors = table.column("descriptor").flatten().to_numpy().reshape(len(table), length)
        table = table.drop_columns(["descriptor", *FRAME_COLUMNS])
        for k in range(length):
            table = table.append_column(f"d{k}", pa.array(descriptors[:, k]))
        text = pa.BufferOutputStream()
        if not self._header_written:
            text.write((",".join(table.schema.names) + "\n").encode("ascii"))
        pyarrow.csv.write_csv(table, text, pyarrow.csv.WriteOptions(include_header=False))
        with self._output.writing() as file:
            file.write(text.getvalue())
            file.flush()
        self._header_written = True

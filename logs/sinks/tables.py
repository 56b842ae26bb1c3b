"""Tracked lines as a table: in a Parquet file, for notebooks and for reading back, and as CSV.

A Parquet file has its index at the end and is nothing without it. So rows go into a journal first, an Arrow IPC stream
that is readable up to its last whole batch. Every batch holds whole frames, and in its metadata the notes on them.
"""

from __future__ import annotations

import csv
import io
import logging
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from airline.errors import InputError, errors_of
from frontend.camera.model import CameraModel
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from logs.read import read_journal
from logs.sinks.output import OutputFile, check_csv, check_new, check_table, journal_of, tables_of, whole_file
from logs.tracks.json import Camera
from logs.tracks.table import FRAME_COLUMNS, RIGHT_COLUMNS, SCHEMA, TableNotes, points_of, to_batch

_ROWS_WAITING = 50_000  # at most, 21 MB
_GROUP_ROWS = 100_000  # 42 MB
_DESCRIPTOR_LENGTH = 6  # of a CSV file without rows
_NOT_IN_CSV = ("descriptor", *FRAME_COLUMNS)

log = logging.getLogger(__name__)


def _is_due(output: OutputFile, frames: list[LineTracks]) -> bool:
    """Whether to write what is waiting: at least every second."""
    return output.flush_is_due() or sum(map(len, frames)) >= _ROWS_WAITING


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
            options = pa.ipc.IpcWriteOptions(compression="lz4")  # without a right image a third is null
            self._stream = pa.ipc.new_stream(file, SCHEMA, options=options)
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
        if _is_due(self._output, self._frames):
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


def finish_journal(path: Path, out: Path, overwrite: bool = False) -> int:
    """Make a Parquet file of a journal, in bounded memory, and remove the journal; returns the number of rows.

    Args:
        path: the journal, which may be cut anywhere: all whole batches are used.
        out: the Parquet file; it appears when it is complete.
        overwrite: replace an existing file.

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


class CsvTrackSink:
    """Writes each frame's tracks into a CSV file, one line per observation; a `Sink`.

    The columns are those of the Parquet file, with the descriptor as d0, d1, ... and without what belongs to a whole
    frame. Those of a right image are there where the first frame with lines has one: later frames without have NaN, 0
    and false, and of partners that come later `close` warns, which are left out. Floats have the shortest text that
    reads back as the same float32, always with a point or an exponent, and NaN where there is none: whatever stands in
    the first lines, readers that guess types find the right ones. All frames, those without lines too, are listed in
    NAME.frames.csv, with their number of lines and the reason of a reset; points in NAME.points.csv, where there are
    any. Neither is written where the file is a pipe or device, and `close` warns of the points.
    Arguments and errors are those of `OutputFile`.
    """

    def __init__(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        path = Path(path)
        check_csv(path, overwrite)
        self._output = OutputFile(path, overwrite)
        frames, self._points_path = tables_of(path)
        self._table = OutputFile(frames, overwrite) if path.is_file() else None
        self._points: OutputFile | None = None
        self._left_out = 0  # points
        self._paired: bool | None = None  # whether the first lines came with a right image
        self._partners_left_out = 0
        if self._table is not None:
            with errors_of(self._points_path):
                self._points_path.unlink(missing_ok=True)
        self._frames: list[LineTracks] = []
        self._descriptor_length: int | None = None
        self._header_written = self._listed = False

    def write(self, result: FrameResult) -> None:
        """Add one frame's tracks."""
        tracks = result.tracks
        length = tracks.descriptors.shape[1]
        if len(tracks):
            if self._descriptor_length not in (None, length):
                raise InputError(
                    f"'{self._output.path}' has columns for {self._descriptor_length} numbers of a descriptor, "
                    f"but frame {tracks.frame_index} has {length}"
                )
            self._descriptor_length = length
            if self._paired is None:
                self._paired = len(tracks.right_hits) > 0
            if not self._paired:
                self._partners_left_out += int(np.count_nonzero(tracks.right_hits))
        self._frames.append(tracks)
        if _is_due(self._output, self._frames):
            self._flush()

    def close(self) -> None:
        """Write the rest; safe to call twice."""
        try:
            if self._output.is_open:
                self._flush()
                if not self._header_written:
                    self._write_rows(to_batch([]))
                self._output.close()
                if self._left_out:
                    log.warning(
                        "'%s' has no place for points, %d are left out: write a file, which gets %s beside it",
                        self._output.path,
                        self._left_out,
                        "NAME.points.csv",
                    )
                if self._partners_left_out:
                    log.warning(
                        "'%s' has no columns for the right image, which the first lines had not: "
                        "the partners of %d lines are left out; Parquet has both kinds of frames",
                        *(self._output.path, self._partners_left_out),
                    )
        finally:
            for table in (self._table, self._points):
                if table is not None:
                    table.close()

    def _flush(self) -> None:
        table, listed = to_batch(self._frames), io.StringIO()
        rows = csv.writer(listed, lineterminator="\n")
        if not self._listed:
            rows.writerow(("frame", "stamp_ns", "lines", "reset"))
        rows.writerows((one.frame_index, one.stamp_ns, len(one), one.reset) for one in self._frames)
        with_points = [one for one in self._frames if len(one.point_ids)]
        if with_points and self._table is not None:
            begun, self._points = self._points is not None, self._points or OutputFile(self._points_path, False)
            _append(self._points, _as_csv(points_of(with_points), not begun))
        elif self._table is None:
            self._left_out += sum(len(one.point_ids) for one in with_points)
        self._frames = []
        if len(table):  # the first tell the columns
            self._write_rows(table)
        if self._table is not None:
            _append(self._table, listed.getvalue().encode())
        self._listed = True

    def _write_rows(self, table: pa.RecordBatch) -> None:
        length = _DESCRIPTOR_LENGTH if self._descriptor_length is None else self._descriptor_length
        descriptors = table.column("descriptor").flatten().to_numpy().reshape(len(table), length)
        columns = dict(zip(table.schema.names, table.columns, strict=True))
        columns |= {f"d{k}": pa.array(descriptors[:, k]) for k in range(length)}
        for name in RIGHT_COLUMNS:
            if not self._paired:
                del columns[name]
            elif not pa.types.is_floating(columns[name].type):
                columns[name] = columns[name].fill_null(pa.scalar(0).cast(columns[name].type))
        columns = {name: column for name, column in columns.items() if name not in _NOT_IN_CSV}
        _append(self._output, _as_csv(pa.table(columns), not self._header_written))
        self._header_written = True


def _append(output: OutputFile, text: bytes) -> None:
    with output.writing() as file:
        file.write(text)
        file.flush()


def _as_csv(table: pa.Table, header: bool) -> bytes:
    text = pa.BufferOutputStream()
    if header:
        text.write((",".join(table.column_names) + "\n").encode("ascii"))
    columns = [_as_text(column.combine_chunks()) for column in table.columns]
    options = pyarrow.csv.WriteOptions(include_header=False, quoting_style="none")
    pyarrow.csv.write_csv(pa.table(columns, names=table.column_names), text, options)
    return text.getvalue().to_pybytes()  # type: ignore[no-any-return]


def _as_text(column: pa.Array) -> pa.Array:
    """Floats in a form that pandas, polars and DuckDB all take for floats, in any line; other columns as they are."""
    if not pa.types.is_floating(column.type):
        return column
    numbers = pa.array(column.to_numpy(zero_copy_only=False), from_pandas=True)  # null for NaN
    return pc.replace_substring_regex(numbers.cast(pa.string()), r"^-?\d+$", r"\0.0").fill_null("NaN")

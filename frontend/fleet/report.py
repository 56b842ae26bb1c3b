"""What became of all recordings: a Parquet file that is kept up to date, and a table for the terminal."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from frontend.fleet.job import Row, Status

if TYPE_CHECKING:
    from rich.table import Table

_WRITE_S = 1.0  # a batch that is killed leaves a report that is at most so old, and as old as its last recording


class Report:
    """A row per recording, in a Parquet file.

    Args:
        path: the file; it is replaced at once, and complete at any time.
        rows: of all recordings, as they are now.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(self, path: Path, rows: Iterable[Row]) -> None:
        self.path = path
        self._rows = {row.name: row for row in rows}
        self.write()

    @property
    def rows(self) -> list[Row]:
        """What became of each recording, in the order of the inputs."""
        return list(self._rows.values())

    def update(self, row: Row) -> None:
        """Replace the row of a recording."""
        self._rows[row.name] = row
        if time.monotonic() - self._written > _WRITE_S:
            self.write()

    def write(self) -> None:
        """Bring the file up to date."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        from logs.sinks.output import errors_of

        text, whole, real = pa.string(), pa.int64(), pa.float64()
        kinds = {"attempts": whole, "frames": whole, "skipped_frames": whole, "tracks": whole}
        kinds |= dict.fromkeys(("lines_per_frame", "track_length_median", "fps", "seconds"), real)
        kinds |= {"warnings": pa.list_(text)}
        names = Row.__dataclass_fields__
        schema = pa.schema([(name, kinds.get(name, text)) for name in names])
        rows = [_storable(asdict(row)) for row in self._rows.values()]
        unfinished = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        with errors_of(self.path):
            try:
                pq.write_table(pa.Table.from_pylist(rows, schema), unfinished)
                unfinished.replace(self.path)
            finally:
                unfinished.unlink(missing_ok=True)
        self._written = time.monotonic()

    def table(self) -> Table:
        """Recordings, frames, tracks and seconds by status."""
        from rich.table import Table

        table = Table("", "recordings", "frames", "tracks", "seconds")
        for status in get_args(Status):
            rows = [row for row in self._rows.values() if row.status == status]
            if rows:
                frames, tracks = (sum(getattr(row, name) or 0 for row in rows) for name in ("frames", "tracks"))
                seconds = sum(row.seconds or 0.0 for row in rows)
                table.add_row(status, f"{len(rows)}", f"{frames}", f"{tracks}", f"{seconds:.1f}")
        return table

    def failures(self) -> list[str]:
        """A line for each recording that failed, with its reason."""
        return [_printable(f"{row.name}: {row.reason}") for row in self._rows.values() if row.status == "failed"]


def _storable(value: Any) -> Any:
    """The same with only such text as Parquet can hold."""
    if isinstance(value, dict):
        return {key: _storable(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_storable(entry) for entry in value]
    return _printable(value) if isinstance(value, str) else value


def _printable(text: str) -> str:
    """File names may hold bytes that are no text."""
    return text.encode("utf-8", "replace").decode()

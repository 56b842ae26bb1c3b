"""What became of all recordings: a Parquet file that is kept up to date, and a few lines for the terminal."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

from airline.errors import InputError
from frontend.batch.job import Row, Status

REPORT = "report.parquet"
SUMS = ("frames", "tracks", "seconds")


def write_report(path: Path, rows: Collection[Row]) -> None:
    """Write a row per recording; the file is replaced at once, and complete at any time.

    Raises:
        InputError: it cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    text, whole, real = pa.string(), pa.int64(), pa.float64()
    kinds = dict.fromkeys(("attempts", "frames", "skipped_frames", "tracks"), whole)
    kinds |= dict.fromkeys(("lines_per_frame", "track_length_median", "fps", "seconds"), real)
    kinds |= {"warnings": pa.list_(text)}
    schema = pa.schema([(name, kinds.get(name, text)) for name in Row.__dataclass_fields__])
    table = [{name: _printable(value) for name, value in asdict(row).items()} for row in rows]
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        pq.write_table(pa.Table.from_pylist(table, schema), unfinished)
        unfinished.replace(path)
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from error
    finally:
        unfinished.unlink(missing_ok=True)


def summary_lines(rows: Collection[Row]) -> list[str]:
    """What became of how many recordings, and the reasons of those that failed."""
    lines = []
    for status in get_args(Status):
        found = [row for row in rows if row.status == status]
        if found:
            frames, tracks, seconds = (sum(getattr(row, name) or 0 for row in found) for name in SUMS)
            lines.append(f"{status}: {len(found)} recordings, {frames} frames, {tracks} tracks, {seconds:.1f} s")
    return lines + [_printable(f"failed {row.name}: {row.reason}") for row in rows if row.status == "failed"]


def _printable(value: Any) -> Any:
    """File names, and what tells of them, may hold bytes that are no text."""
    if isinstance(value, tuple):
        return [_printable(entry) for entry in value]
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value

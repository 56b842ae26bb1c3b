"""The tables as pandas, polars and DuckDB read them, with nothing of ours in between: types, values, frames."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest

from frontend.fields import ROWS, Field
from frontend.tracks import DERIVED, FIELDS, LineTracks
from logs.sinks.open import open_track_sink
from tests.helpers.made_tracks import FISHEYE, PAIR, clip_results, made_tracks, write_all


def stream(counts: list[int], first_id: int = 0, **given: Any) -> list[LineTracks]:
    rng = np.random.default_rng(0)
    ids = (np.arange(count) + first_id for count in counts)
    return [made_tracks(7 * k + 2, 10**18 + k, one, rng, lost=k % 3, ended=1, **given) for k, one in enumerate(ids)]


def odd_numbers() -> list[LineTracks]:
    (tracks,) = stream([4])
    tracks.segments_px[0] = 0.0
    tracks.scores[:] = [0, 1, -0.0, 1e-30]
    tracks.covariances[:, 0, 0] = [3, 1e7, 123456792, 1e20]
    tracks.consistency[:] = [np.nan, np.nan, 0, 1e-7]
    tracks.observed_covariances[:] = np.nan
    return [tracks]


CASES: dict[str, Callable[[], list[LineTracks]]] = {
    "the clip": lambda: [result.tracks for result in clip_results()],
    "one row": lambda: stream([1]),
    "first frames without lines": lambda: stream([0, 0, 3, 0, 2, 0]),
    "no lines at all": lambda: stream([0, 0, 0]),
    "no frames": list,
    "no camera": lambda: stream([3, 0, 2], camera=None),
    "camera after 200 rows": lambda: [*stream([120, 120], camera=None), *stream([0, 0, 5])[2:]],
    "another camera, points out of its reach": lambda: stream([40, 40], camera=FISHEYE),
    "a right image, but not in the second frame": lambda: [
        *stream([3], camera=PAIR, right=True),
        *stream([0, 3], camera=PAIR)[1:],
        *stream([0, 0, 9], camera=PAIR, right=True)[2:],
    ],
    "ids that no float holds": lambda: stream([3, 2], first_id=2**62 + 1),
    "resets": lambda: stream([2, 0, 2], reset='gap, of "1" s;\nthen, more'),
    "odd numbers": odd_numbers,
}


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[LineTracks]]:
    folder, tracks = tmp_path_factory.mktemp("tables"), CASES[request.param]()
    for ending in ("parquet", "csv"):
        write_all(open_track_sink(f"{folder}/tracks.{ending}"), tracks)
    return folder, tracks


Columns = dict[str, tuple[str, list[Any]]]  # type and values, None for null


def by_pandas(path: Path) -> Columns:
    table = (pd.read_parquet if path.suffix == ".parquet" else pd.read_csv)(path)
    values = {name: [None if one is None else one for one in table[name].tolist()] for name in table}
    return {name: (str(table[name].dtype), values[name]) for name in table}


def by_polars(path: Path) -> Columns:
    table = (pl.read_parquet if path.suffix == ".parquet" else pl.read_csv)(path)
    return {name: (str(table[name].dtype), table[name].to_list()) for name in table.columns}


def by_duckdb(path: Path) -> Columns:
    table = duckdb.sql(f"SELECT * FROM '{path}'")
    rows = table.fetchall()
    return {
        name: (str(kind), [row[k] for row in rows])
        for k, (name, kind) in enumerate(zip(table.columns, table.types, strict=True))
    }


READERS = [by_pandas, by_polars, by_duckdb]
TYPES = {  # what each reader calls them
    "<i8": ("int64", "Int64", "BIGINT"),
    "<i4": ("int32", "Int32", "INTEGER"),
    "<f4": ("float32", "Float32", "FLOAT"),
    "<f8": ("float64", "Float64", "DOUBLE"),
    "|b1": ("bool", "Boolean", "BOOLEAN"),
    "word": ("str", "String", "VARCHAR"),
    "<i8 list": ("object", "List(Int64)", "BIGINT[]"),
    "<i4 list": ("object", "List(Int32)", "INTEGER[]"),
    "<f4 list": ("object", "List(Float32)", "FLOAT[]"),
}
STATES = np.array(["tentative", "confirmed"], object)


def expected(tracks: list[LineTracks], csv: bool) -> Columns:
    """Type, as numpy writes it, and values of every column."""

    def joined(one: Field, seen: LineTracks) -> Any:
        found = getattr(seen, one.name)
        rows = len(seen.ids if one.rows == "right" else getattr(seen, ROWS[one.rows][1]))
        if found is not None and len(found) == rows:
            return found
        nothing = (np.nan if one.dtype.kind == "f" else one.dtype.type(0)) if csv else None
        return np.full((rows, *one.shape), nothing)

    columns: Columns = {
        "stamp_ns": ("<i8", [one.stamp_ns for one in tracks for _ in one.ids]),
        "frame": ("<i8", [one.frame_index for one in tracks for _ in one.ids]),
    }
    paired = next((len(one.right_hits) > 0 for one in tracks if len(one)), False)
    for field in (*FIELDS, *DERIVED):
        if csv and field.rows == "right" and not paired:
            continue
        names, kind = [name for name, _ in field.numbers], field.dtype.str
        if field.rows not in ("seen", "right"):
            for k, name in enumerate(names):
                cells = [
                    None
                    if field in DERIVED and one.camera is None
                    else [*joined(field, one).reshape(-1, len(names))[:, k]]
                    for one in tracks
                ]
                spread = [[cell] + [None] * (len(one) - 1) for cell, one in zip(cells, tracks, strict=True) if len(one)]
                columns[name] = f"{kind} list", [cell for row in spread for cell in row]
        elif field.name == "descriptors":
            rows = [list(row) for one in tracks for row in one.descriptors]
            columns["descriptor"] = f"{kind} list", rows
            columns |= {f"d{k}": (kind, [row[k] for row in rows]) for k in range(6)}
        elif field.name == "states":
            columns["state"] = "word", [STATES[state] for one in tracks for state in one.states]
        else:
            rows = [row for one in tracks for row in joined(field, one).reshape(len(one), math.prod(field.shape))]
            columns |= {name: (kind, [row[k] for row in rows]) for k, name in enumerate(names)}
    columns["reset"] = "word", [cell for one in tracks if len(one) for cell in [one.reset] + [None] * (len(one) - 1)]
    if not csv:
        return {name: column for name, column in columns.items() if name[:1] != "d" or not name[1:].isdigit()}
    wider = {"<i4": "<i8", "<f4": "<f8"}  # text does not say how long a number is
    return {
        name: (wider.get(kind, kind), values)
        for name, (kind, values) in columns.items()
        if "list" not in kind and name != "reset"
    }


def same(found: Any, value: Any) -> bool:
    """Whether a cell is what was written: numbers bit by bit, where pandas has NaN for null."""
    if value is None or (isinstance(value, float | np.floating) and np.isnan(value)):
        return found is None or bool(np.isnan(found))
    if isinstance(value, list):
        return len(found) == len(value) and all(map(same, found, value))
    return bool(np.float32(found) == value if isinstance(value, np.floating) else found == value)


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_types_and_values_are_those_that_were_written(case, ending: str, read: Callable[[Path], Columns]) -> None:
    folder, tracks = case
    found, columns = read(folder / f"tracks.{ending}"), expected(tracks, csv=ending == "csv")
    assert found.keys() == columns.keys()
    has_rows = any(map(len, tracks))
    for name, (kind, values) in columns.items():
        if ending == "parquet" or has_rows:  # a header alone tells no types
            if read is by_pandas and None in values:
                kind = {"<i4": "<f8", "|b1": "<i8 list"}.get(kind, kind)
            assert found[name][0] == TYPES[kind][READERS.index(read)], name
        assert len(found[name][1]) == len(values)
        assert all(map(same, found[name][1], values)), name


def test_points_are_a_table_too(tmp_path: Path) -> None:
    """As their own CSV file, and from the lists of a Parquet file by the recipe of docs/mcap.md."""
    tracks = [*stream([2, 2], points=3), *stream([0, 1, 2, 3], points=4, camera=None)[3:]]
    names = ["point_id", "point_x", "point_y", "point_u", "point_v"]
    nowhere = np.full((4, 2), np.nan, np.float32)
    arrays = [(t.points_px, nowhere if t.points_normalized is None else t.points_normalized) for t in tracks]
    expected = [
        [np.concatenate([t.point_ids for t in tracks])],
        *(np.concatenate(each).T for each in zip(*arrays, strict=True)),
    ]
    columns = [column for group in expected for column in group]
    for ending in ("csv", "parquet"):
        write_all(open_track_sink(f"{tmp_path}/t.{ending}"), tracks)
    lists = ["frame", "stamp_ns", *names]
    by_pandas = pd.read_parquet(tmp_path / "t.parquet", columns=lists).dropna(subset="point_id").explode(names[:3])
    by_polars = pl.read_parquet(tmp_path / "t.parquet", columns=lists).drop_nulls("point_id").explode(names[:3])
    for table in (pd.read_csv(tmp_path / "t.points.csv"), by_pandas, by_polars.to_pandas()):
        assert table["frame"].tolist() == [t.frame_index for t in tracks for _ in t.point_ids]
        assert table["stamp_ns"].tolist() == [t.stamp_ns for t in tracks for _ in t.point_ids]
    for read in (pd.read_csv, lambda path: pl.read_csv(path).to_pandas()):
        table = read(tmp_path / "t.points.csv")
        for name, values in zip(names, columns, strict=True):
            np.testing.assert_array_equal(table[name].to_numpy().astype(values.dtype), values)
    for table in (by_pandas, by_polars.to_pandas()):
        for name, values in zip(names[:3], columns, strict=False):
            np.testing.assert_array_equal(table[name].to_numpy().astype(values.dtype), values)


def test_polars_and_duckdb_tell_null_from_nan(tmp_path: Path) -> None:
    tracks = stream([2, 2], camera=FISHEYE)
    tracks[0].segments_px[:] = 1e6
    write_all(open_track_sink(f"{tmp_path}/t.parquet"), [*tracks, *stream([0, 0, 2], camera=None)[2:]])
    for read in (by_polars, by_duckdb):
        cells = read(tmp_path / "t.parquet")["u0"][1]
        assert [one is None for one in cells] == [False] * 4 + [True] * 2
        assert [bool(np.isnan(one)) for one in cells[:4]] == [True, True, False, False]


def frames_by_pandas(path: Path) -> list[tuple[Any, ...]]:
    """The recipe of docs/mcap.md."""
    if path.suffix == ".csv":
        frames = pd.read_csv(path)
    else:
        lines = pd.read_parquet(path, columns=["frame", "stamp_ns", "reset"]).drop_duplicates("frame")
        empty = json.loads(pq.read_metadata(path).metadata[b"frames without rows"])
        frames = pd.concat([lines, pd.DataFrame(empty, columns=lines.columns).astype(lines.dtypes)])
        assert len(frames) == 0 or [str(kind) for kind in frames.dtypes] == ["int64", "int64", "str"]
    rows = frames.sort_values("frame")[["frame", "stamp_ns", "reset"]].itertuples(index=False)
    return [(*row[:2], None if pd.isna(row[2]) else row[2]) for row in rows]


def frames_by_polars(path: Path) -> list[tuple[Any, ...]]:
    if path.suffix == ".csv":
        frames = pl.read_csv(path)
    else:
        lines = pl.read_parquet(path, columns=["frame", "stamp_ns", "reset"]).unique("frame", keep="first")
        empty = json.loads(pl.read_parquet_metadata(path)["frames without rows"])
        frames = pl.concat([lines, pl.DataFrame(empty, schema=lines.schema)])
    return frames.sort("frame").select("frame", "stamp_ns", "reset").rows()


def frames_by_duckdb(path: Path) -> list[tuple[Any, ...]]:
    if path.suffix == ".csv":
        return duckdb.sql(f"SELECT frame, stamp_ns, reset FROM '{path}' ORDER BY frame").fetchall()
    kinds = '[{"frame": "BIGINT", "stamp_ns": "BIGINT", "reset": "VARCHAR"}]'
    return duckdb.sql(
        f"SELECT frame, stamp_ns, reset FROM '{path}' WHERE lost_ids IS NOT NULL UNION ALL "
        f"SELECT unnest(from_json(decode(value), '{kinds}'), recursive := true) "
        f"FROM parquet_kv_metadata('{path}') WHERE key = 'frames without rows' ORDER BY frame"
    ).fetchall()


@pytest.mark.parametrize("read", [frames_by_pandas, frames_by_polars, frames_by_duckdb])
@pytest.mark.parametrize("name", ["tracks.parquet", "tracks.frames.csv"])
def test_every_frame_is_found(case, name: str, read: Callable[[Path], list[tuple[Any, ...]]]) -> None:
    folder, tracks = case
    assert read(folder / name) == [(one.frame_index, one.stamp_ns, one.reset) for one in tracks]


def test_the_list_of_frames_counts_their_lines(tmp_path: Path) -> None:
    write_all(open_track_sink(f"{tmp_path}/t.csv"), stream([0, 3, 0]))
    assert pd.read_csv(tmp_path / "t.frames.csv")["lines"].tolist() == [0, 3, 0]

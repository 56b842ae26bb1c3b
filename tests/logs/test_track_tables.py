"""Tracks in Parquet and CSV: what a notebook finds, and the same tracks read back."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from airline.errors import InputError
from frontend.tracks import DERIVED
from logs.read import read_tracks
from logs.sinks.open import check
from logs.sinks.tables import CsvTrackSink, ParquetTrackSink
from logs.tracks.table import FRAME_COLUMNS, RIGHT_COLUMNS, SCHEMA, TableNotes
from tests.helpers.made_tracks import CAMERA, FISHEYE, assert_all_same, clip_results, made_tracks, write_all


def write(path, stream) -> None:
    write_all((ParquetTrackSink if path.suffix == ".parquet" else CsvTrackSink)(path), stream)


@pytest.fixture(scope="module")
def clip():
    return [result.tracks for result in clip_results()]


@pytest.fixture(scope="module")
def path(tmp_path_factory, clip):
    path = tmp_path_factory.mktemp("table") / "tracks.parquet"
    write(path, clip)
    return path


def test_one_row_per_observation(path, clip):
    table = pq.read_table(path)
    column = {name: table[name].to_numpy() for name in table.column_names if name != "descriptor"}
    np.testing.assert_array_equal(column["frame"], np.repeat(np.arange(12), list(map(len, clip))))
    for names, field in (
        ("id", "ids"),
        ("x0 y0 x1 y1", "segments_px"),
        ("observed_x0 observed_y0 observed_x1 observed_y1", "observed_px"),
        ("u0 v0 u1 v1", "segments_normalized"),
        ("var_offset cov_offset_angle cov_offset_angle var_angle", "covariances"),
        ("measured", "measured"),
        *((" ".join(name for name, _ in one.numbers), one.name) for one in DERIVED if one.rows == "seen"),
    ):
        expected = np.concatenate([getattr(tracks, field) for tracks in clip])
        found = np.stack([column[name] for name in names.split()], axis=1).reshape(expected.shape)
        np.testing.assert_array_equal(found, expected)
        assert found.dtype == expected.dtype


def test_the_file_explains_itself(path):
    file = pq.ParquetFile(path)
    assert "(0, 0)" in file.metadata.metadata[b"pixels"].decode()
    assert file.metadata.metadata[b"schema version"] == b"1"
    assert json.loads(file.metadata.metadata[b"cameras"])[0]["camera"]["width"] == 320
    for field in file.schema_arrow:
        assert field.metadata[b"description"], field.name
    assert file.schema_arrow.field("x0").metadata[b"unit"] == b"px"
    assert file.metadata.row_group(0).column(0).compression == "ZSTD"


def test_frames_across_batches_and_row_groups(tmp_path, monkeypatch):
    monkeypatch.setattr("logs.read._BATCH_ROWS", 7)
    monkeypatch.setattr("logs.sinks.tables._GROUP_ROWS", 20)
    monkeypatch.setattr("logs.sinks.tables._ROWS_WAITING", 10)
    rng = np.random.default_rng(1)
    counts = [0, 3, 30, 0, 0, 1, 8, 7, 7, 0, 5, 0]
    stream = [made_tracks(5 * k, k, np.arange(n), rng, lost=n % 3, ended=1) for k, n in enumerate(counts)]
    write(tmp_path / "t.parquet", stream)
    assert pq.ParquetFile(tmp_path / "t.parquet").num_row_groups > 1
    assert_all_same(list(read_tracks(tmp_path / "t.parquet")), stream)


@pytest.mark.parametrize("name", ["u0", "observed_u0", "line_a", "line_var_angle"])
def test_normalized_numbers_are_null_without_a_camera_and_nan_out_of_its_reach(tmp_path, name):
    rng = np.random.default_rng(0)
    cameras = [None, FISHEYE, CAMERA, None]
    stream = [made_tracks(k, k, np.arange(2), rng, camera=camera) for k, camera in enumerate(cameras)]
    stream[1].segments_px[0, 0] = stream[1].observed_px[0, 0] = 1e6
    write(tmp_path / "t.parquet", stream)
    column = pq.read_table(tmp_path / "t.parquet")[name].combine_chunks()
    assert column.is_null().to_pylist() == [True, True, False, False, False, False, True, True]
    assert np.isnan(column.to_numpy(zero_copy_only=False)).tolist() == [True, True, True, *[False] * 3, True, True]
    write(tmp_path / "t.csv", stream)
    with (tmp_path / "t.csv").open() as file:
        values = [row[name] for row in csv.DictReader(file)]
    assert [value == "NaN" for value in values] == [True, True, True, *[False] * 3, True, True]


def test_csv_holds_the_same_numbers(tmp_path, path, clip):
    write(tmp_path / "t.csv", clip)
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    table = pq.read_table(path)
    descriptors = {f"d{k}" for k in range(6)}
    assert rows[0].keys() == (set(SCHEMA.names) - {"descriptor", *FRAME_COLUMNS, *RIGHT_COLUMNS}) | descriptors
    typed = pa.csv.read_csv(tmp_path / "t.csv")
    for name in {"measured", "stable"}:  # true and false, which pandas takes for a mask
        assert typed[name].equals(table[name])
    for name in rows[0].keys() - descriptors - {"measured", "stable"}:
        values = table[name].to_numpy()
        np.testing.assert_array_equal(np.array([row[name] for row in rows]).astype(values.dtype), values, err_msg=name)
    found = np.array([[row[f"d{k}"] for k in range(6)] for row in rows]).astype(np.float32)
    np.testing.assert_array_equal(found, np.concatenate([t.descriptors for t in clip]))


def test_csv_lists_frames_where_it_can(tmp_path):
    (tmp_path / "t.frames.csv").write_text("mine")
    for refused in (CsvTrackSink, lambda path: check(str(path))):
        with pytest.raises(InputError, match=r"t\.frames\.csv' exists"):
            refused(tmp_path / "t.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["t.frames.csv"]
    write_all(CsvTrackSink("/dev/null", overwrite=True), [])
    assert not Path("/dev/null.frames.csv").exists()


def test_points_have_a_csv_file_of_their_own_where_there_are_any(tmp_path):
    rng = np.random.default_rng(0)
    frames = [made_tracks(k, k, np.arange(2), rng, points=count) for k, count in enumerate([0, 2, 0, 3])]
    write(tmp_path / "a.csv", frames[:1])
    write(tmp_path / "b.csv", frames)
    assert not (tmp_path / "a.points.csv").exists()
    with (tmp_path / "b.points.csv").open() as file:
        assert [row["frame"] for row in csv.DictReader(file)] == ["1", "1", "3", "3", "3"]
    (tmp_path / "b.csv").unlink()
    (tmp_path / "b.frames.csv").unlink()
    with pytest.raises(InputError, match=r"b\.points\.csv' exists"):
        CsvTrackSink(tmp_path / "b.csv")
    write_all(CsvTrackSink(tmp_path / "b.csv", overwrite=True), frames[:1])
    assert not (tmp_path / "b.points.csv").exists(), "points of an earlier run are none of this one's"


def test_only_csv_is_taken_off_the_name_of_the_list(tmp_path):
    for name in ("run.1", "run.2", "run.3.csv", "run.4.CSV"):
        write_all(CsvTrackSink(tmp_path / name), [])
    assert {path.name for path in tmp_path.glob("*frames*")} == {f"run.{k}.frames.csv" for k in (1, 2, 3, 4)}


def test_csv_without_rows_has_a_header(tmp_path):
    write(tmp_path / "t.csv", [made_tracks(0, 0, np.arange(0), np.random.default_rng(0))])
    assert (tmp_path / "t.csv").read_text().count("\n") == 1


def test_partners_that_csv_has_no_columns_for_are_counted(tmp_path, caplog):
    rng = np.random.default_rng(0)
    stream = [made_tracks(k, k, np.arange(n), rng, right=k > 1) for k, n in enumerate([0, 3, 9])]
    write(tmp_path / "a.csv", stream)
    assert "the partners of 6 lines are left out" in caplog.text
    assert "right_x0" not in (tmp_path / "a.csv").read_text()
    write(tmp_path / "b.csv", [stream[0], stream[2], stream[1]])
    with (tmp_path / "b.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["right_hits"] == "0" for row in rows] == [*[False, True, False] * 3, *[True] * 3]
    assert [row["right_x0"] == "NaN" for row in rows] == [*[False, True, False] * 3, *[True] * 3]


def test_only_some_tracks_of_a_frame_cannot_have_a_right_image(tmp_path):
    stream = [made_tracks(0, 0, np.arange(3), np.random.default_rng(0), right=True)]
    write(tmp_path / "a.parquet", stream)

    def cut(table, notes):
        for name in RIGHT_COLUMNS:
            table, _ = column(name, lambda values: [None, *values[1:]])(table, notes)
        return table, notes

    altered(tmp_path / "a.parquet", tmp_path / "b.parquet", cut)
    with pytest.raises(InputError, match="disagree"):
        list(read_tracks(tmp_path / "b.parquet"))


def test_csv_with_another_descriptor(tmp_path):
    rng = np.random.default_rng(0)
    stream = [made_tracks(k, k, np.arange(3), rng, length=6 - k) for k in range(2)]
    with pytest.raises(InputError, match="frame 1 has 5"):
        write(tmp_path / "t.csv", stream)


def altered(path, out, change) -> None:
    """Write a Parquet file again with its table and metadata changed."""
    table = pq.read_table(path)
    notes = {key: pq.ParquetFile(path).metadata.metadata[key] for key in (b"cameras", b"frames without rows")}
    table, notes = change(table, notes)
    with pq.ParquetWriter(out, table.schema) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata(notes)


def column(name, values):
    def change(table, notes):
        kind = table.schema.field(name).type
        k = table.column_names.index(name)
        return table.set_column(k, pa.field(name, kind), pa.array(values(table[name].to_pylist()), kind)), notes

    return change


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda table, notes: (table.drop_columns("x1"), notes), "no column 'x1'"),
        (lambda table, notes: (table.cast(pa.schema([f.with_type(pa.float64()) if f.name == "x0" else f
                                                     for f in table.schema])), notes), "no column 'x0'"),
        (lambda table, notes: (table, {}), "notes"),
        (lambda table, notes: (table, {**notes, b"cameras": b'[{"from": 0, "camera": {"width": 0}}]'}), "notes"),
        (lambda table, notes: (table, {**notes, b"frames without rows": b'[{"place": 0, "tracks": 3}]'}), "notes"),
        (lambda table, notes: (table.slice(1), notes), "first of a frame"),
        (column("lost_ids", lambda values: [None] * len(values)), "first of a frame"),
        (column("ended_ids", lambda values: [None] * len(values)), "lists are missing"),
        (column("lost_ids", lambda values: [v if v is None else [*v, 7] for v in values]), "different lengths"),
        (column("state", lambda values: ["lost", *values[1:]]), "unknown state"),
        (column("state", lambda values: [None, *values[1:]]), "unknown state"),
        (column("x0", lambda values: [None, *values[1:]]), "numbers are missing"),
        (column("right_x0", lambda values: [1.0, *values[1:]]), "numbers are missing"),
        (column("right_hits", lambda values: [3, *values[1:]]), "numbers are missing"),
        (column("frame", lambda values: [*values[:-1], 0]), "disagree"),
        (column("descriptor", lambda values: [*values[:-1], [1.0]]), "disagree"),
    ],
)  # fmt: skip
def test_tables_of_others_are_refused_in_one_sentence(path, tmp_path, change, complaint):
    altered(path, tmp_path / "t.parquet", change)
    with pytest.raises(InputError, match=complaint) as error:
        list(read_tracks(tmp_path / "t.parquet"))
    assert "\n" not in str(error.value)


def test_cut_and_foreign_files_are_refused(path, tmp_path):
    whole = path.read_bytes()
    for name in ("t.parquet", "t.parquet.unfinished"):
        for text in (b"", b"PAR1", b"no such thing" * 99, whole[:-1], whole[: len(whole) // 2]):
            (tmp_path / name).write_bytes(text)
            with pytest.raises(InputError, match=name):
                list(read_tracks(tmp_path / name))


def test_notes_of_frames_beyond_the_stream_are_refused():
    tracks = made_tracks(0, 0, np.arange(2), np.random.default_rng(0))
    notes = TableNotes(empty={0: tracks})
    with pytest.raises(InputError, match="has some"):
        TableNotes().add({key.encode(): value for key, value in notes.to_metadata().items()})

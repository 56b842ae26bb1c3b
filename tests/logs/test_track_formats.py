"""Tracks in every format: each holds every field of the table, and gives back what went in."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from airline.errors import InputError
from frontend.tracks import DERIVED, FIELDS, LineTracks
from logs.read import read_tracks
from logs.sinks.open import open_track_sink
from logs.sinks.output import journal_of
from logs.sinks.tables import ParquetTrackSink
from logs.tracks.json import SCHEMA, decode_tracks, encode_tracks
from logs.tracks.message import decode, encode
from tests.helpers.command import ROOT
from tests.helpers.made_tracks import (
    PAIR,
    assert_all_same,
    assert_same,
    clip_results,
    made_tracks,
    result_of,
    streams,
    write_all,
)

CLIP = [
    made_tracks(k, k, np.arange(3 + k), np.random.default_rng(k), lost=k, ended=1, camera=PAIR, right=True)
    for k in range(3)
]


def by_json(stream: list[LineTracks], folder: Path) -> list[LineTracks]:
    return [decode_tracks(encode_tracks(tracks)) for tracks in stream]


def by_message(stream: list[LineTracks], folder: Path) -> list[LineTracks]:
    found = [decode(encode(result_of(tracks), stream=1, sequence=2, name="", sent_ns=3)).tracks for tracks in stream]
    return [tracks for tracks in found if tracks is not None]


def by_mcap(stream: list[LineTracks], folder: Path) -> list[LineTracks]:
    path = write(stream, folder / "t.mcap")
    if stream:
        return list(read_tracks(path))
    with pytest.raises(InputError, match="no messages"):
        list(read_tracks(path))
    return []


def by_parquet(stream: list[LineTracks], folder: Path) -> list[LineTracks]:
    return list(read_tracks(write(stream, folder / "t.parquet")))


def by_journal(stream: list[LineTracks], folder: Path) -> list[LineTracks]:
    sink = ParquetTrackSink(folder / "j.parquet", overwrite=True)
    for k, tracks in enumerate(stream):
        sink.write(result_of(tracks))
        if k % 3 == 0:
            sink.flush()
    sink.flush()
    found = list(read_tracks(journal_of(folder / "j.parquet")))
    sink.close()
    return found


FORMATS = [by_json, by_message, by_mcap, by_parquet, by_journal]


def write(stream: list[LineTracks], path: Path) -> Path:
    write_all(open_track_sink(str(path), overwrite=True), stream)
    return path


@pytest.mark.parametrize("there_and_back", FORMATS)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(streams())
def test_odd_streams_come_back_exactly(there_and_back: Callable, tmp_path: Path, stream: list[LineTracks]) -> None:
    assert_all_same(there_and_back(stream, tmp_path), stream)


@pytest.mark.parametrize("there_and_back", FORMATS)
def test_the_clip_comes_back_exactly(there_and_back: Callable, tmp_path: Path) -> None:
    stream = [result.tracks for result in clip_results()]
    assert_all_same(there_and_back(stream, tmp_path), stream)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_every_float32_survives_json(value: float) -> None:
    tracks = made_tracks(0, 0, np.arange(1), np.random.default_rng(0))
    tracks.scores[0] = value
    assert_same(decode_tracks(encode_tracks(tracks)), tracks)


@pytest.mark.parametrize("there_and_back", FORMATS)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(streams())
def test_what_is_derived_is_what_it_was(there_and_back: Callable, tmp_path: Path, stream: list[LineTracks]) -> None:
    """Also the columns of the file itself, made for many frames at once: null where the object has None."""
    for found, sent in zip(there_and_back(stream, tmp_path), stream, strict=True):
        for field in DERIVED:
            np.testing.assert_array_equal(getattr(found, field.name), getattr(sent, field.name), field.name)
    if there_and_back is by_parquet:
        table, sent = pq.read_table(tmp_path / "t.parquet"), [tracks for tracks in stream if len(tracks)]
        for field in (one for one in (*FIELDS, *DERIVED) if one.rows == "right"):
            values = [getattr(tracks, field.name) for tracks in sent]
            absent = [value is None or not len(value) for value in values]
            for k, (name, _) in enumerate(field.numbers):
                numbers = [value.reshape(len(value), -1)[:, k] for value in values if value is not None and len(value)]
                assert table[name].is_null().to_pylist() == np.repeat(absent, [len(t) for t in sent]).tolist(), name
                np.testing.assert_array_equal(table[name].drop_null().to_numpy(), np.concatenate([*numbers, []]), name)


@pytest.mark.parametrize("there_and_back", [by_mcap, by_parquet, by_journal])
def test_history_is_read_back(there_and_back: Callable, tmp_path: Path) -> None:
    stream = [result.tracks for result in clip_results()]
    assert sum(len(tracks.history) for tracks in stream) > 10
    for found, sent in zip(there_and_back(stream, tmp_path), stream, strict=True):
        assert_all_same(list(found.history), list(sent.history))


def test_files_from_before_a_field_have_what_stands_for_it(tmp_path: Path) -> None:
    later = [field for field in FIELDS if field.older is not None]
    assert {field.rows for field in later} == {"seen", "right", "lost", "points"}
    gone = {*(field.name for field in later), *(field.name for field in DERIVED)}
    stream = [tracks for tracks in CLIP if len(tracks)]
    texts = [json.loads(encode_tracks(tracks)) for tracks in stream]
    messages = [msgspec.msgpack.decode(encode(result_of(t), stream=1, sequence=0, name="", sent_ns=0)) for t in stream]
    for message in messages:
        message["arrays"] = {name: array for name, array in message["arrays"].items() if name not in gone}
    path = write(stream, tmp_path / "t.parquet")
    table, notes = pq.read_table(path), pq.ParquetFile(path).metadata.metadata
    columns = {name for field in (*later, *DERIVED) for name, _ in field.numbers}
    old = table.drop_columns(sorted(columns))
    numbers = pa.array(np.concatenate([tracks.states for tracks in stream]))  # before there were words
    old = old.set_column(old.column_names.index("state"), pa.field("state", pa.uint8(), False), numbers)
    with pq.ParquetWriter(path, old.schema) as writer:
        writer.write_table(old)
        writer.add_key_value_metadata({key: notes[key] for key in (b"cameras", b"frames without rows")})
    found = [
        [decode_tracks(json.dumps({k: v for k, v in text.items() if k not in gone}).encode()) for text in texts],
        [decode(msgspec.msgpack.encode(message)).tracks for message in messages],
        list(read_tracks(path)),
    ]
    none = ("points", "right")
    expected = [
        replace(
            t, **{f.name: np.full_like(getattr(t, f.name), f.older)[: 0 if f.rows in none else None] for f in later}
        )
        for t in stream
    ]
    for one in found:
        assert_all_same(one, expected)


@pytest.mark.parametrize("field", [*FIELDS, *DERIVED], ids=lambda field: field.name)
def test_every_format_holds_every_field(field, tmp_path: Path) -> None:
    columns = {name for name, _ in field.numbers}
    described = SCHEMA["properties"].get(field.name) or SCHEMA["patternProperties"][f"^{field.name}$"]
    assert described["description"] == field.text
    assert field.name in json.loads(encode_tracks(CLIP[0]))
    message = msgspec.msgpack.decode(encode(result_of(CLIP[0]), stream=0, sequence=0, name="", sent_ns=0))
    assert np.dtype(message["arrays"][field.name]["dtype"]) == field.dtype
    assert columns <= set(pq.read_schema(write(CLIP, tmp_path / "t.parquet")).names)
    with write(CLIP, tmp_path / "t.csv").open() as file:
        header = set(next(csv.reader(file)))
    assert columns <= header or field.name == "descriptors" or field.rows not in ("seen", "right")


ONE_LINE = '    parallax: Annotated[Float32, Field("how far the line moves against its neighbours", "px", older=1)]\n'
WITH_A_NEW_FIELD = """
import sys, numpy as np
from pathlib import Path
from frontend.tracks import FIELDS
from logs.read import read_tracks
from tests.logs.test_track_formats import CLIP, FORMATS, write
folder = Path(sys.argv[1])
assert "parallax" in [field.name for field in FIELDS] and CLIP[0].parallax.any()
for there_and_back in FORMATS:
    for found, sent in zip(there_and_back(CLIP, folder), CLIP, strict=True):
        assert np.array_equal(found.parallax, sent.parallax)
assert "parallax" in write(CLIP, folder / "t.csv").read_text().partition("\\n")[0].split(",")
for name in ("old.mcap", "old.parquet"):
    assert all((tracks.parallax == 1).all() for tracks in read_tracks(folder / name))
"""


def test_a_new_field_is_one_line(tmp_path: Path) -> None:
    """In a copy of `frontend`: every format has it, and files from before it are readable."""
    for name in ("old.mcap", "old.parquet"):
        write(CLIP, tmp_path / name)
    shutil.copytree(ROOT / "frontend", tmp_path / "frontend", ignore=shutil.ignore_patterns("__pycache__"))
    table = tmp_path / "frontend" / "tracks.py"
    table.write_text(table.read_text().replace("    right_px: Annotated", ONE_LINE + "    right_px: Annotated", 1))
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]\n{WITH_A_NEW_FIELD}"
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")

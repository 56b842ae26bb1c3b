"""Outputs for tracked lines: chosen by name, several at once, never over others, readable after a crash."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airline.errors import ConfigError, InputError
from frontend.tracks import FIELDS, LineTracks
from logs.read import read_tracks
from logs.repair import main
from logs.sinks.open import check, guess_of, kind_and_path, open_track_sink
from logs.sinks.tables import ParquetTrackSink, finish_journal
from tests.helpers.made_tracks import PAIR, assert_all_same, clip_results, made_tracks, result_of, write_all

ROOT = Path(__file__).parents[2]
ALL = ("all.mcap", "all.parquet", "all.csv", "limap/", "plvins.mcap", "all.bag")


def write(spec: str, results, **options) -> None:
    sink = open_track_sink(spec, **options)
    for result in results:
        sink.write(result)
    sink.close()
    sink.close()


@pytest.mark.parametrize(
    ("spec", "kind", "path"),
    [
        ("a/tracks.mcap", "mcap", "a/tracks.mcap"),
        ("Tracks.PARQUET", "parquet", "Tracks.PARQUET"),
        ("t.csv", "csv", "t.csv"),
        ("a/plvins.mcap", "plvins", "a/plvins.mcap"),
        ("run_plvins.mcap", "plvins", "run_plvins.mcap"),
        ("Lines.bag", "bag", "Lines.bag"),
        ("plvins.bag", "plvins", "plvins.bag"),
        ("a/run_EPLF.bag", "eplf", "a/run_EPLF.bag"),
        ("eplf.mcap", "eplf", "eplf.mcap"),
        ("uvslam.bag", "uvslam", "uvslam.bag"),
        ("uvslam:t.bag", "uvslam", "t.bag"),
        ("a/limap", "limap", "a/limap"),
        ("anything/", "limap", "anything"),
        ("plvins:t.mcap", "plvins", "t.mcap"),
        ("mcap:plvins.mcap", "mcap", "plvins.mcap"),
        ("limap:out", "limap", "out"),
        ("csv:t.txt", "csv", "t.txt"),
        ("bag:plvins.mcap", "bag", "plvins.mcap"),
    ],
)
def test_a_name_tells_its_kind(spec, kind, path):
    assert kind_and_path(spec) == (kind, Path(path))


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("drive_uvslam.mcap", "drive_uvslam.mcap is for UV-SLAM.*: give mcap:drive_uvslam.mcap for Foxglove"),
        ("a/drive_plvins.mcap", "drive_plvins.mcap is for PL-VINS.*: give mcap:a/drive_plvins.mcap for Foxglove"),
        ("drive_eplf.bag", "drive_eplf.bag is for EPLF-VINS.*: give bag:drive_eplf.bag for PL-VINS"),
        *((spec, "") for spec in ("uvslam.mcap", "uvslam:my_uvslam.mcap", "mcap:my_uvslam.mcap", "my_plvins.bag")),
        *((spec, "") for spec in ("tracks.mcap", "limap/", "tracks.bag")),
    ],
)
def test_a_kind_that_a_name_only_hints_at_is_said(spec: str, said: str) -> None:
    note = guess_of(spec)
    assert (note is None) == (not said)
    assert note is None or re.search(said, note)


def test_a_system_that_needs_points_is_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"UV-SLAM takes points .*: add --points"):
        check(str(tmp_path / "uvslam.bag"))
    check(str(tmp_path / "uvslam.bag"), points=True)
    check(str(tmp_path / "eplf.bag"))


@pytest.mark.parametrize("kind", ["csv", "limap"])
def test_points_that_an_output_has_no_place_for_are_counted(
    kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rng = np.random.default_rng(0)
    stream = [made_tracks(k, k, np.arange(2), rng, points=3 + k) for k in range(2)]
    place = Path(os.devnull) if kind == "csv" else tmp_path / "limap"
    write(f"{kind}:{place}", map(result_of, stream), overwrite=True)
    (said,) = caplog.messages
    assert "7 are left out" in said


@pytest.mark.parametrize("spec", ["tracks", "tracks.txt", "xyz:t.mcap.gz", ""])
def test_an_unknown_name_lists_the_kinds(spec):
    with pytest.raises(InputError, match=r"NAME\.parquet.*LIMAP"):
        check(spec)


@pytest.mark.parametrize("name", ALL)
def test_nothing_is_overwritten_unasked(tmp_path, name):
    spec, results = f"{tmp_path}/{name}", clip_results()
    write(spec, results)
    beside = ["all.frames.csv"] if name == "all.csv" else []
    assert sorted(path.name for path in tmp_path.iterdir()) == [name.strip("/"), *beside], "no journal is left"
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for refused in (check, open_track_sink):
        with pytest.raises(InputError, match="--overwrite"):
            refused(spec)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    check(spec, overwrite=True)
    write(spec, results[:3], overwrite=True)
    after = {path for path in tmp_path.rglob("*") if path.is_file()}
    assert after <= before.keys()
    if name in ("all.mcap", "all.parquet"):
        assert len(list(read_tracks(spec))) == 3


@pytest.mark.parametrize("name", ALL)
def test_a_parent_that_is_no_folder(tmp_path, name):
    (tmp_path / "file").write_text("")
    for parent in ("missing", "file"):
        with pytest.raises(InputError, match="folder"):
            check(f"{tmp_path}/{parent}/{name}")
    assert not (tmp_path / "missing").exists()


def test_a_leftover_journal_is_named(tmp_path):
    sink = ParquetTrackSink(tmp_path / "t.parquet")
    sink.write(clip_results()[0])
    for refused in (check, open_track_sink):
        with pytest.raises(InputError, match=r"t\.parquet\.unfinished.*logs\.repair"):
            refused(f"{tmp_path}/t.parquet")
    sink.close()


def expected(count: int) -> list[LineTracks]:
    return [made_tracks(k, k * 10_000_000, np.arange(60), np.random.default_rng(k), lost=k % 3) for k in range(count)]


def clip_journal(path: Path) -> tuple[bytes, list[int]]:
    """The journal of the clip with a batch for each frame, and where the header and every batch end."""
    sink, journal = ParquetTrackSink(path), path.with_name(path.name + ".unfinished")
    ends = [journal.stat().st_size]
    for result in clip_results():
        sink.write(result)
        sink.flush()
        ends.append(journal.stat().st_size)
    whole = journal.read_bytes()
    sink.close()
    return whole, ends


def test_a_journal_becomes_a_clean_file(tmp_path, capsys):
    journal = tmp_path / "t.parquet.unfinished"
    journal.write_bytes(clip_journal(tmp_path / "whole.parquet")[0])
    (tmp_path / "whole.parquet").unlink()
    before = [result.tracks for result in clip_results()]
    assert main([str(journal)]) == 0  # python -m logs.repair
    assert capsys.readouterr().out == f"{tmp_path / 't.parquet'}: finished, {sum(map(len, before))} rows\n"
    assert_all_same(list(read_tracks(tmp_path / "t.parquet")), before)
    assert [path.name for path in tmp_path.iterdir()] == ["t.parquet"]


def test_a_journal_cut_anywhere(tmp_path, caplog):
    results = clip_results()
    whole, ends = clip_journal(tmp_path / "t.parquet")
    cut, out = tmp_path / "c.parquet.unfinished", tmp_path / "c.parquet"
    sizes = np.random.default_rng(0).integers(ends[1], len(whole), 10).tolist()
    for size in [*sizes, *ends[2:]]:
        cut.write_bytes(whole[:size])
        frames = sum(end <= size for end in ends[1:])
        caplog.clear()
        assert_all_same(list(read_tracks(cut)), [result.tracks for result in results[:frames]])
        assert len(caplog.records) == (size not in ends)
        assert finish_journal(cut, out, overwrite=True) == sum(len(result.tracks) for result in results[:frames])
        assert len(list(read_tracks(out))) == frames
        assert not cut.exists()


def test_finishing_never_overwrites(tmp_path):
    sink = ParquetTrackSink(tmp_path / "t.parquet")
    sink.write(clip_results()[0])
    (tmp_path / "t.parquet").write_text("somebody else's")
    with pytest.raises(InputError, match=r"exists.*t\.parquet\.unfinished"):
        sink.close()
    assert (tmp_path / "t.parquet").read_text() == "somebody else's"
    assert len(list(read_tracks(tmp_path / "t.parquet.unfinished"))) == 1


LIMITED = """
import resource, signal, sys
from pathlib import Path
from airline.errors import InputError
from tests.helpers.made_tracks import result_of
from tests.logs.test_track_sinks import expected
from logs.sinks import output
from logs.sinks.open import open_track_sink
from logs.sinks.tables import finish_journal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
stream = expected(500)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
output.FLUSH_S = 0.0
for path in sys.argv[2:]:
  count = 0
  try:
    if path.endswith(".unfinished"):
        finish_journal(Path(path), Path(path).with_suffix(""))
    sink = open_track_sink(path)
    for tracks in stream:
        sink.write(result_of(tracks))
        count += 1
  except InputError as error:
    print(count, error)
    if count: sink.close()
"""


def written_until_full(room: int, *paths: Path) -> list[tuple[int, str]]:
    """Of each: how many frames a process wrote that may fill files up to so many bytes, and its error."""
    command = [sys.executable, "-c", LIMITED, str(room), *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    said = [line.split(maxsplit=1) for line in done.stdout.splitlines()]
    return [(int(count), message) for count, message in said]


def test_a_full_disk_is_an_error_that_names_the_file(tmp_path):
    names = ["all.mcap", "all.parquet", "all.csv", "plvins.mcap", "all.bag"]
    ends = written_until_full(100_000, *(tmp_path / name for name in names))
    for name, (count, message) in zip(names, ends, strict=True):
        assert name in message
        assert "too large" in message
        if name in ("all.mcap", "all.parquet"):
            found = list(read_tracks(tmp_path / (name if name == "all.mcap" else name + ".unfinished")))
            assert len(found) > count - 3
            assert_all_same(found, expected(len(found)))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("kind", ["mcap", "csv", "plvins", "bag"])
def test_a_disk_that_is_full_from_the_start(kind):
    with pytest.raises(InputError, match=r"/dev/full.*No space left"):
        write(f"{kind}:/dev/full", clip_results(), overwrite=True)


def test_no_room_for_the_parquet_file_leaves_the_journal(tmp_path):
    journal = tmp_path / "t.parquet.unfinished"
    journal.write_bytes(clip_journal(tmp_path / "whole.parquet")[0])
    (tmp_path / "whole.parquet").unlink()
    ((_, message),) = written_until_full(500, journal)
    assert message.startswith(f"cannot write '{tmp_path}/t.parquet'")
    assert [path.name for path in tmp_path.iterdir()] == ["t.parquet.unfinished"]


def test_bad_quality():
    from logs.sinks.foxglove import McapTrackSink

    with pytest.raises(ConfigError, match="1 to 100"):
        McapTrackSink("never.mcap", jpeg_quality=0)
    assert not Path("never.mcap").exists()


@pytest.mark.parametrize("name", ["limap", "plvins.bag", "uvslam.mcap"])
def test_formats_for_one_camera_take_the_left_lines_and_say_so(name, tmp_path, caplog):
    rng = np.random.default_rng(0)
    stereo = [made_tracks(k, k * 10**8, np.arange(6), rng, camera=PAIR, right=True, points=0) for k in range(3)]
    none = {field.name: getattr(stereo[0], field.name)[:0] for field in FIELDS if field.rows == "right"}
    written = []
    for folder, stream in (("one", [replace(tracks, **none) for tracks in stereo]), ("two", stereo)):
        (tmp_path / folder).mkdir()
        write_all(open_track_sink(f"{tmp_path}/{folder}/{name}", points="uvslam" in name), stream)
        files = sorted(path for path in (tmp_path / folder).rglob("*") if path.is_file())
        written.append({path.relative_to(tmp_path / folder): path.read_bytes() for path in files})
    assert written[0] == written[1]
    said = [message for message in caplog.messages if "partners" in message]
    assert [message.partition(" takes ")[2] for message in said] == ["the left lines, 12 partners are left out"]

"""The importer for the Rerun viewer: files with tracks are opened, all others are left to others at once."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer

from frontend.colours import track_colours
from frontend.tracks import LineTracks
from logs.sinks.mcap_tracks import McapTrackSink
from logs.sinks.parquet import ParquetTrackSink
from tests.helpers.command import recorded
from tests.helpers.made_tracks import clip_results
from tests.helpers.ports import free_port
from tests.helpers.viewer import RERUN, ROOT, needs_viewer
from viz.film import write_film
from viz.importer import NOT_MINE
from viz.track_files import kind_of

HEAVY = ("rerun", "torch", "pyarrow", "numpy", "cv2")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with the same tracks in every format: clip.mcap (with images), clip.parquet and its journal."""
    folder = tmp_path_factory.mktemp("tracks")
    for sink in (McapTrackSink(folder / "clip.mcap", with_images=True), ParquetTrackSink(folder / "clip.parquet")):
        for result in clip_results():
            sink.write(result)
        sink.close()
    unfinished = ParquetTrackSink(folder / "killed.parquet")
    for result in clip_results():
        unfinished.write(result)
    unfinished._writer.flush()
    unfinished._output.file.flush()
    yield folder
    unfinished.close()


def importer(*arguments: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "viz.importer", *map(str, arguments)], cwd=ROOT, capture_output=True, timeout=60
    )


def imported(folder: Path, *arguments: object) -> dict[str, dict[str, list]]:
    outcome = importer(*arguments)
    assert (outcome.returncode, outcome.stderr) == (0, b"")
    (folder / "out.rrd").write_bytes(outcome.stdout)
    return recorded(folder / "out.rrd")


def assert_tracks(columns: dict[str, list], expected: list[LineTracks]) -> None:
    assert columns["frame"] == [tracks.frame_index for tracks in expected]
    assert columns["sensor_time"] == [tracks.stamp_ns for tracks in expected]
    for row, tracks in enumerate(expected):
        assert columns["track_id"][row] == tracks.ids.tolist()
        strips = np.array(columns["LineStrips2D:strips"][row], np.float32)
        np.testing.assert_array_equal(strips, tracks.segments_px + np.float32(0.5))


@pytest.mark.parametrize("name", ["clip.mcap", "clip.parquet", "killed.parquet.unfinished"])
def test_numbers_are_those_of_the_file(files, tmp_path, name):
    entities = imported(tmp_path, files / name)
    expected = [result.tracks for result in clip_results()]
    assert_tracks(entities["/camera/tracks"], expected)
    assert entities["/stats/counts/tracks"]["frame"] == [tracks.frame_index for tracks in expected]
    found = [values[0] for values in entities["/stats/counts/confirmed"]["Scalars:scalars"] if values]
    assert found == [tracks.confirmed.sum() for tracks in expected]
    images = entities["/camera/image"]
    if name == "clip.mcap":
        assert images["frame"] == [tracks.frame_index for tracks in expected]
        shown = cv2.imdecode(np.array(images["EncodedImage:blob"][3][0], np.uint8), cv2.IMREAD_COLOR)
        assert np.abs(shown.astype(int) - clip_results()[3].frame.image).mean() < 4  # JPEG
    else:
        assert "frame" not in images
        background = cv2.imdecode(np.array(images["EncodedImage:blob"][0][0], np.uint8), cv2.IMREAD_COLOR)
        assert background.max() < 64
    assert any(path.startswith("/camera") and "Pinhole:resolution" in c for path, c in entities.items()) == (
        expected[0].camera is not None
    )


def foreign_files(folder: Path, files: Path) -> list[Path]:
    write_film(folder / "film.mp4", [np.zeros((48, 64, 3), np.uint8)] * 3, 30)
    cv2.imwrite(str(folder / "picture.png"), np.zeros((8, 8), np.uint8))
    pq.write_table(pa.table({"id": [1, 2], "x0": [0.5, 1.5]}), folder / "foreign.parquet")
    with (folder / "foreign.mcap").open("wb") as file:
        log = Writer(file)
        log.start(profile="ros2")
        channel = log.register_channel("/imu", "json", log.register_schema("Imu", "jsonschema", b"{}"))
        log.add_message(channel, 5, b"{}", 5)
        log.finish()
    (folder / "empty.mcap").touch()
    (folder / "text.txt").write_text("airline-frontend, topic of tracks")
    whole = (files / "clip.parquet").read_bytes()
    (folder / "cut.parquet").write_bytes(whole[: len(whole) // 2])  # its footer is gone: nobody can tell whose it was
    (folder / "start.parquet").write_bytes(b"PAR1")
    (folder / "start.mcap").write_bytes(b"\x89MCAP0\r\n")
    (folder / "strange.parquet").write_bytes(b"PAR1" + b"\xff" * 20 + b"PAR1")
    return [*sorted(folder.iterdir()), folder, folder / "none.mcap", folder / ("long" * 100)]


def test_foreign_files_are_answered_without_heavy_imports(files, tmp_path):
    foreign = foreign_files(tmp_path, files)
    for path in foreign:
        assert kind_of(path) is None, path
    code = (
        "import sys; from viz.importer import main; codes = [main([f]) for f in sys.argv[1:]]; "
        f"print(codes, [name for name in {HEAVY} if name in sys.modules])"
    )
    outcome = subprocess.run(
        [sys.executable, "-c", code, *map(str, foreign)], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert (outcome.stdout.strip(), outcome.stderr) == (f"{[NOT_MINE] * len(foreign)} []", "")
    assert importer(tmp_path / "film.mp4", "--application-id", "film").returncode == NOT_MINE


def test_our_log_that_was_cut_is_opened_as_far_as_it_goes(tmp_path, monkeypatch):
    monkeypatch.setattr("logs.sinks.output.FLUSH_S", 0)  # a chunk for each frame
    sink = McapTrackSink(tmp_path / "whole.mcap")
    for result in clip_results():
        sink.write(result)
    sink.close()
    whole = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    outcome = importer(tmp_path / "cut.mcap")
    assert outcome.returncode == 0
    assert b"cut or damaged" in outcome.stderr
    (tmp_path / "out.rrd").write_bytes(outcome.stdout)
    columns = recorded(tmp_path / "out.rrd")["/camera/tracks"]
    assert 2 < len(columns["frame"]) < 10
    assert_tracks(columns, [result.tracks for result in clip_results()][: len(columns["frame"])])


def test_our_table_that_is_damaged_is_refused(files, tmp_path):
    data = bytearray((files / "clip.parquet").read_bytes())
    data[1000:1100] = bytes(100)
    (tmp_path / "bad.parquet").write_bytes(data)
    outcome = importer(tmp_path / "bad.parquet")
    assert outcome.returncode == 2
    assert outcome.stderr.startswith(b"error: cannot read tracks from")
    assert b"Traceback" not in outcome.stderr


def test_what_the_viewer_passes_is_honoured(files, tmp_path):
    from rerun.chunk import RrdReader

    given = ["--application-id", "some_app", "--recording-id", "some_id", "--opened-recording-id", "other"]
    given += [
        "--entity-path-prefix",
        "robot/left",
        "--time_sequence",
        "episode=7",
        "--time_duration_nanos",
        "wait=1500",
    ]
    entities = imported(tmp_path, files / "clip.mcap", *given, "--unknown", "1")
    assert {path.split("/")[1] for path in entities if not path.startswith("/__")} == {"robot"}
    tracks = entities["/robot/left/camera/tracks"]
    assert set(tracks["episode"]) == {7}
    assert set(tracks["wait"]) == {1500}
    stores = RrdReader(tmp_path / "out.rrd").recordings()
    assert [(store.application_id, store.recording_id) for store in stores] == [("some_app", "some_id")]


@pytest.fixture
def on_path(tmp_path: Path) -> dict[str, str]:
    """An environment in which Rerun finds the importer."""
    script = tmp_path / "bin" / "rerun-importer-airline"
    script.parent.mkdir()
    script.write_text(f"#!{sys.executable}\nimport sys\nfrom viz.importer import main\nsys.exit(main())\n")
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    path = f"{script.parent}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), "CI": "1"}


@pytest.mark.skipif(not RERUN.exists(), reason="needs Rerun's executable")
@pytest.mark.parametrize("name", ["clip.mcap", "clip.parquet"])
def test_rerun_starts_the_importer_for_endings_it_does_not_know(files, tmp_path, on_path, name):
    dropped = tmp_path / "clip.lines"
    dropped.symlink_to(files / name)
    command = [RERUN, dropped, "--save", tmp_path / "out.rrd", "--port", str(free_port()), "--bind", "127.0.0.1"]
    subprocess.run(command, env=on_path, capture_output=True, timeout=60, check=True)
    assert_tracks(recorded(tmp_path / "out.rrd")["/camera/tracks"], [result.tracks for result in clip_results()])


@needs_viewer
def test_viewer_shows_what_is_imported(files, tmp_path, on_path, monkeypatch):
    from viz.snapshot import save_picture

    monkeypatch.setattr(os, "environ", on_path)
    (tmp_path / "clip.lines").symlink_to(files / "clip.mcap")
    picture = tmp_path / "picture.png"
    assert save_picture(tmp_path / "clip.lines", picture, frame=8, size=(1280, 800)) == []
    shown = cv2.imread(str(picture)).astype(int)
    tracks = clip_results()[8].tracks
    whole = tracks.confirmed & (tracks.fragment_of < 0)
    lengths = np.linalg.norm(tracks.segments_px[:, 1] - tracks.segments_px[:, 0], axis=1)
    for row in np.flatnonzero(whole & (lengths > 40)):
        colour = track_colours(tracks.ids[[row]])[0, ::-1]
        assert (np.abs(shown - colour).max(axis=2) < 12).sum() > 50, f"no line in the colour {colour}"

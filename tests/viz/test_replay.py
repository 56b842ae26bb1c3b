"""Files with tracks as recordings: their numbers, their images, and what is said of damaged ones."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from logs.sinks.foxglove import McapTrackSink
from logs.sinks.tables import ParquetTrackSink
from tests.helpers.command import command, curve, recorded, refusal, seen_tracks
from tests.helpers.made_tracks import clip_results, made_tracks, write_all, write_tracks
from tests.helpers.ports import free_port
from tests.helpers.viewer import TRACKS, names_of_views, saving_viewer
from viz.replay import main


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with the same tracks in every format: clip.mcap (with images), clip.parquet and its journal."""
    folder = tmp_path_factory.mktemp("tracks")
    write_tracks(McapTrackSink(folder / "clip.mcap", with_images=True), clip_results())
    write_tracks(ParquetTrackSink(folder / "clip.parquet"), clip_results())
    with closing(ParquetTrackSink(folder / "killed.parquet")) as unfinished:
        for result in clip_results():
            unfinished.write(result)
        unfinished.flush()
        yield folder


def assert_tracks(columns: dict[str, list], count: int) -> None:
    expected = [result.tracks for result in clip_results()][:count]
    assert columns["frame"] == [tracks.frame_index for tracks in expected]
    assert columns["sensor_time"] == [tracks.stamp_ns for tracks in expected]
    for row, tracks in enumerate(expected):
        assert columns["track_id"][row] == tracks.ids.tolist()
        strips = np.array(columns["LineStrips2D:strips"][row], np.float32)
        np.testing.assert_array_equal(strips, tracks.segments_px + np.float32(0.5))


@pytest.mark.parametrize("name", ["clip.mcap", "clip.parquet", "killed.parquet.unfinished"])
def test_numbers_are_those_of_the_file(files, tmp_path, name):
    outcome = command(files / name, "--save", tmp_path / "out.rrd", main=main)
    assert (outcome.code, outcome.err) == (0, "")
    assert f"with {len(clip_results())} frames" in outcome.out
    rows = recorded(tmp_path / "out.rrd")
    expected = [result.tracks for result in clip_results()]
    assert_tracks(seen_tracks(rows), len(expected))
    assert curve(rows, "counts", "confirmed") == [tracks.confirmed.sum() for tracks in expected]
    assert ("/camera/image" in rows) == (name == "clip.mcap")
    if name == "clip.mcap":
        images = rows["/camera/image"]
        assert images["frame"] == [tracks.frame_index for tracks in expected]
        shown = cv2.imdecode(np.array(images["EncodedImage:blob"][3][0], np.uint8), cv2.IMREAD_COLOR)
        assert np.abs(shown.astype(int) - clip_results()[3].frame.image).mean() < 6
    assert names_of_views(tmp_path / "out.rrd") == {TRACKS, "Lines per frame", "Log"}


def test_lost_lines_are_drawn_for_three_frames_unless_asked_for(tmp_path):
    tracks = made_tracks(0, 0, np.arange(9), np.random.default_rng(0), lost=4)
    tracks = replace(tracks, lost_frames=np.array([1, 3, 4, 30], np.int32))
    write_all(ParquetTrackSink(tmp_path / "lost.parquet"), [tracks])
    for flags, count in (((), 2), (("--show-lost",), 4)):
        assert command(tmp_path / "lost.parquet", "--save", tmp_path / "out.rrd", *flags, main=main).code == 0
        rows = recorded(tmp_path / "out.rrd")
        assert rows["/camera/tracks/lost"]["track_id"] == [tracks.lost_ids[:count].tolist()]
        assert seen_tracks(rows)["measured"] == [tracks.measured.tolist()]


def test_a_log_that_was_cut_is_shown_as_far_as_it_goes(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("logs.sinks.output.FLUSH_S", 0)  # a chunk for each frame
    write_tracks(McapTrackSink(tmp_path / "whole.mcap"), clip_results())
    whole = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    assert command(tmp_path / "cut.mcap", "--save", tmp_path / "out.rrd", main=main).code == 0
    assert "cut or damaged" in caplog.text
    columns = seen_tracks(recorded(tmp_path / "out.rrd"))
    assert 2 < len(columns["frame"]) < 10
    assert_tracks(columns, len(columns["frame"]))


@pytest.mark.parametrize(
    ("name", "save", "says"),
    [
        ("bad.parquet", "out.rrd", "cannot read tracks from"),
        ("none.mcap", "out.rrd", "cannot read tracks from"),
        ("text.parquet", "out.rrd", "no MCAP or Parquet file with tracks"),
        ("clip.parquet", "out.txt", "ends with .rrd"),
        ("clip.parquet", "none/out.rrd", "in a folder that exists"),
    ],
)
def test_what_cannot_be_shown_is_said_in_one_sentence(files, tmp_path, name, save, says):
    data = bytearray((files / "clip.parquet").read_bytes())
    (tmp_path / "clip.parquet").write_bytes(data)
    data[1000:1100] = bytes(100)
    (tmp_path / "bad.parquet").write_bytes(data)
    (tmp_path / "text.parquet").write_text("no tracks")
    assert says in refusal(tmp_path / name, "--save", tmp_path / save, main=main)


def test_a_viewer_that_runs_shows_it(files, tmp_path):
    port = free_port()
    with saving_viewer(port, tmp_path / "received.rrd"):
        assert main([str(files / "clip.parquet"), "--connect", f"127.0.0.1:{port}"]) == 0
    assert_tracks(seen_tracks(recorded(tmp_path / "received.rrd")), len(clip_results()))


def test_a_viewer_that_is_not_there_is_an_error(files):
    error = refusal(files / "clip.parquet", "--connect", f"127.0.0.1:{free_port()}", main=main)
    assert "there is no viewer at" in error

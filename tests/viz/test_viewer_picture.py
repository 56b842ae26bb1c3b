"""A picture of the real viewer: it opens what the sink writes, without complaints, and shows the tracks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from frontend.colours import track_colours
from tests.helpers.moving_rectangle import frame_results
from tests.helpers.viewer import needs_viewer, snapshot
from viz.rerun_sink import RerunSink

FRAMES = 10


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "run.rrd"
    sink = RerunSink(save=path)
    for result in frame_results(FRAMES):
        sink.write(result)
    sink.close()
    return path


@needs_viewer
def test_viewer_shows_the_tracks_and_has_no_complaints(recording, tmp_path):
    from viz.snapshot import save_picture

    complaints = save_picture(recording, tmp_path / "picture.png", frame=8, size=(1280, 800))
    assert complaints == []
    picture = cv2.imread(str(tmp_path / "picture.png"))
    assert picture.shape == (800, 1280, 3)
    assert picture.std() > 20
    tracks = list(frame_results(FRAMES))[8].tracks
    for colour in track_colours(tracks.ids, tracks.confirmed)[:, ::-1]:
        near = np.abs(picture.astype(int) - colour).max(axis=2) < 12
        assert near.sum() > 50, f"no line in the colour {colour}"


@needs_viewer
def test_regions_have_their_tracks_colour_whatever_was_shown_first(tmp_path):
    """Ids grow, and the viewer went on with the scale of the classes in the frame that it showed first."""
    from viz.snapshot import _go_to, _headless_viewer, _save_settled, _wait_until_loaded

    sink = RerunSink(save=tmp_path / "run.rrd")
    for result in frame_results(FRAMES):
        ids = result.tracks.ids + 700 * result.frame.index
        sink.write(replace(result, tracks=replace(result.tracks, ids=ids)))
    sink.close()
    with _headless_viewer(tmp_path / "run.rrd", (1280, 800), 60) as client:
        state = _wait_until_loaded(client, tmp_path / "run.rrd")
        for frame in (1, 8):
            _go_to(client, state, frame)
            _save_settled(client, tmp_path / "picture.png")
    beside = cv2.imread(str(tmp_path / "picture.png"))[:560, 780:].astype(int)  # of the view with the tracks
    colour = track_colours(np.array([8 * 700]))[0, ::-1]
    assert (np.abs(beside - colour).max(axis=2) < 12).sum() > 50


@needs_viewer
def test_frame_that_does_not_exist(recording, tmp_path):
    outcome = snapshot(recording, tmp_path / "picture.png", "--frame", 99)
    assert outcome.returncode == 2
    assert outcome.stderr.strip() == "error: there is no frame 99: choose one from 0 to 9"


@needs_viewer
def test_damaged_recording(tmp_path):
    (tmp_path / "bad.rrd").write_bytes(b"no recording" * 100)
    outcome = snapshot(tmp_path / "bad.rrd", tmp_path / "picture.png")
    assert outcome.returncode == 2
    assert "damaged or was cut short" in outcome.stderr


@needs_viewer
def test_no_graphics_driver(recording, tmp_path):
    outcome = snapshot(recording, tmp_path / "picture.png", VK_DRIVER_FILES="/none", VK_ICD_FILENAMES="/none")
    assert outcome.returncode == 2
    assert "install a Vulkan driver" in outcome.stderr


def test_missing_recording(tmp_path):
    outcome = snapshot(tmp_path / "none.rrd", tmp_path / "picture.png")
    assert outcome.returncode == 2
    assert "there is no recording" in outcome.stderr

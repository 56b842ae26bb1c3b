"""A picture of the real viewer: it opens what the sink writes, without complaints, and shows the tracks."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from frontend.colours import track_colours
from tests.moving_rectangle import frame_results
from tests.viewer import needs_viewer, snapshot
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

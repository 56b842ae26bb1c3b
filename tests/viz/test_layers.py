"""Rerun's conventions: properties by which runs are found, and tracks as a layer on somebody's own recording."""

from __future__ import annotations

import time
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from airline import __version__
from airline.network.weights import BUNDLED
from tests.helpers.command import command, recorded, refusal
from tests.helpers.moving_rectangle import HEIGHT, STEP_NS, WIDTH, frame_results
from tests.helpers.viewer import FRAMES, needs_viewer, record
from viz.snapshot import _connect
from viz.viewer import free_port, start, stop

LAYER = {"recording_id": "drive-1", "application_id": "drives", "layer": "cam0/image/lines"}
NAMES = {"frame_timeline": "picture", "time_timeline": "clock"}


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    for result in frame_results(3):
        cv2.imwrite(str(folder / f"{result.frame.index}.png"), result.frame.image)
    return folder


def properties(path: Path) -> dict[str, list]:
    return {name: rows[0] for name, rows in recorded(path)["/__properties/airline"].items() if ":" not in name}


def test_runs_are_told_apart_by_their_properties(images, tmp_path):
    calib = tmp_path / "cam.json"
    calib.write_text(f'{{"width": {WIDTH}, "height": {HEIGHT}, "fx": 90, "fy": 91, "cx": 40, "cy": 30}}')
    for preset, flags in {"fast": [], "accurate": ["--calib", calib, "--max-lines", "50"]}.items():
        save = ("--save", tmp_path / f"{preset}.rrd")
        outcome = command(images, "--headless", *save, "--preset", preset, "--serial", *flags)
        assert outcome.code == 0, outcome.err
    runs = {path: properties(path) for path in tmp_path.glob("*.rrd")}
    (run,) = (path for path, known in runs.items() if known["preset"] == ["accurate"])
    assert run.name == "accurate.rrd"
    known = runs[run]
    assert known["version"] == [__version__]
    assert known["input"] == [str(images)]
    assert known["kind"] == ["images"]
    assert known["size"] == [WIDTH, HEIGHT]
    assert str(calib) in known["calibration"][0]
    assert known["camera"] == [90, 91, 40, 30]
    assert (known["weights"], known["weights_sha256"]) == (["accurate"], [BUNDLED["accurate"]])
    assert tomllib.loads(known["settings"][0])["tracker"]["max_lines"] == 50
    assert known["notes"]
    assert runs[tmp_path / "fast.rrd"]["calibration"] == ["none"]
    assert "camera" not in runs[tmp_path / "fast.rrd"]


@pytest.mark.parametrize(("blueprint", "more"), [("default", set()), ("full", {"tracks/rest", "tracks/lost"})])
def test_a_layer_has_the_tracks_alone(tmp_path, blueprint, more):
    whole = record(tmp_path / "whole.rrd")
    layer = record(tmp_path / "layer.rrd", blueprint=blueprint, properties={"preset": "fast"}, **LAYER, **NAMES)
    names = {"tracks", "tails", *more}
    assert layer.keys() == {f"/cam0/image/lines/{name}" for name in names} | {"/__properties/airline"}
    for name in names:
        ours, theirs = layer[f"/cam0/image/lines/{name}"], whole[f"/camera/{name}"]
        rows = [ours["picture"].index(k) for k in range(FRAMES)]
        assert [ours["clock"][row] for row in rows] == [k * STEP_NS for k in range(FRAMES)]
        for column in ours.keys() - {"rerun.controls.RowId", "picture", "clock"}:
            assert [ours[column][row] for row in rows] == theirs[column]
    reader = RrdReader(tmp_path / "layer.rrd")
    assert [(store.application_id, store.recording_id) for store in reader.recordings()] == [("drives", "drive-1")]
    assert not reader.blueprints()


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("--save run.rrd --layer cam0/lines", "--recording-id"),
        ("--save run.rrd --recording-id a --layer /", "no entity"),
        ("--save run.rrd --recording-id a --layer __properties/x", "belongs to Rerun"),
        ("--save run.rrd --recording-id a --layer x --frame-timeline t --time-timeline t", "not both 't'"),
        ("--save run.rrd --frame-timeline picture", "are for layers"),
        ("--save run.rrd --coordinate-frame cam", "are for layers"),
        ("--out t.csv --recording-id a --layer x", "give --save"),
    ],
)
def test_layers_that_cannot_be(images, tmp_path, monkeypatch, flags, said):
    monkeypatch.chdir(tmp_path)
    assert said in refusal(images, "--headless", *flags.split())


@needs_viewer
@pytest.mark.parametrize("frame", [None, "camera_image_plane"])
def test_the_viewer_shows_a_layer_on_their_image(tmp_path, frame):
    """Theirs is black; what comes of logs has a coordinate frame with a name."""
    theirs = rr.RecordingStream("drives", recording_id="drive-1")
    theirs.save(tmp_path / "theirs.rrd")
    if frame is not None:
        theirs.log("cam0/image", rr.CoordinateFrame(frame), static=True)
    for k in range(FRAMES):
        theirs.set_time("picture", sequence=k)
        theirs.set_time("clock", duration=np.timedelta64(k * STEP_NS, "ns"))
        theirs.log("cam0/image", rr.Image(np.zeros((HEIGHT, WIDTH, 3), np.uint8)))
    theirs.disconnect()
    record(tmp_path / "lines.rrd", **LAYER, **NAMES, coordinate_frame=frame)
    port, picture = free_port(), tmp_path / "picture.png"
    viewer = start(port, "--headless", "--window-size", "800x600", *map(str, tmp_path.glob("*.rrd")))
    assert viewer is not None
    try:
        client = _connect(viewer, port)
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            client.save_screenshot(str(picture))
            state = client.get_state()
            middle = cv2.imread(str(picture))[80:350, 220:580].astype(int)
            lines = np.count_nonzero(np.ptp(middle, axis=2) > 100)
            if lines > 100 and not state.loading:
                break
            time.sleep(0.3)
    finally:
        stop(viewer)
    assert lines > 100
    assert len(state.recordings) == 1
    assert [view.origin for view in state.views] == ["/cam0/image"]
    assert not any(view.reports for view in state.views)

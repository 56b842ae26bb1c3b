"""What a recording and its pictures have of a stereo pair: both images, partners in the colours of tracks, metres."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun.blueprint as rrb

from frontend.colours import track_colours
from frontend.protocols import FrameResult
from tests.helpers.command import EVERY_FRAME, command, curve, recorded
from tests.helpers.moving_rectangle import CAMERA, HEIGHT, WIDTH, frame_results, rectangle
from tests.helpers.viewer import FRAMES, TRACKS, contents_of_views, names_of_views, needs_viewer, record
from viz.blueprint import PARTNERS, layout
from viz.lines import THIN_RADIUS
from viz.overlay import write_film
from viz.recording import BACKGROUND, Recording
from viz.replay import main
from viz.rerun_sink import RerunSink
from viz.snapshot import save_overlay, save_picture

DISPARITY, BASELINE = 20, 0.2
DEPTH = CAMERA.fx * BASELINE / DISPARITY
PAIR = replace(CAMERA, baseline_m=BASELINE)
RIGHT = {"/right/image", "/right/tracks", "/right/tracks/rest", "/stats/partners"}


def pairs(count: int = FRAMES, camera: object = PAIR) -> Iterator[FrameResult]:
    """The rectangle `DEPTH` away; its left side, track 3, has no partner. Tracks 0 and 1 are confirmed, 1 upright."""
    for result in frame_results(count):
        segments = result.tracks.segments_px
        partners = segments - np.float32([DISPARITY, 0])
        partners[3] = np.nan
        tracks = replace(
            result.tracks,
            camera=camera,
            observed_covariances=result.tracks.covariances,
            right_px=partners,
            right_covariances=1.25 * result.tracks.covariances,
            right_hits=np.array([7, 3, 1, 0], np.int32),
            right_measured=np.array([True, False, True, False]),
        )
        right = np.roll(result.frame.image, -DISPARITY, axis=1)
        yield replace(result, tracks=tracks, frame=replace(result.frame, camera=camera, right=right))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stereo") / "run.rrd"


@pytest.fixture(scope="module")
def rows(path: Path) -> dict[str, dict[str, list]]:
    return record(path, pairs(), image="raw", descriptor_every=0)


def test_partners_lie_on_the_right_image_and_look_like_their_tracks(rows):
    assert {name for name in rows if "frame" in rows[name]} == EVERY_FRAME | RIGHT | {"/world/stereo", "/log"}
    for k, result in enumerate(pairs()):
        pixels = np.array(rows["/right/image"]["Image:buffer"][k][0], np.uint8)
        np.testing.assert_array_equal(pixels.reshape(HEIGHT, WIDTH, 3), result.frame.right)
    for name, ids in {"": [0, 1], "/rest": [2]}.items():
        left, right = (rows[f"{root}/tracks{name}"] for root in ("/camera", "/right"))
        assert right["track_id"][8] == ids
        assert right["measured"][8] == [k != 1 for k in ids]
        expected = rectangle(8)[ids] - np.float32([DISPARITY, 0]) + np.float32(0.5)
        np.testing.assert_array_equal(np.float32(right["LineStrips2D:strips"][8]), expected)
        assert right["LineStrips2D:colors"][8] == left["LineStrips2D:colors"][8][: len(ids)]
        thin = np.full(len(ids), THIN_RADIUS * np.sqrt(WIDTH * HEIGHT))
        np.testing.assert_allclose(right["LineStrips2D:radii"][8], thin if name else left["LineStrips2D:radii"][8])


def test_confirmed_lines_of_known_depth_are_in_metres_before_the_camera(rows):
    """Of the two confirmed ones, the other runs along the rows."""
    assert rows["/world/stereo"]["track_id"] == [[]] * 2 + [[1]] * (FRAMES - 2)
    (ends,) = np.array(rows["/world/stereo"]["LineStrips3D:strips"][8])
    plane = (rectangle(8)[1] - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy)
    np.testing.assert_allclose(ends, DEPTH * np.column_stack([plane, [1, 1]]), rtol=1e-5)
    assert rows["/camera"]["Pinhole:image_plane_distance"][0] == [pytest.approx(2 * BASELINE)]


def test_share_and_age_of_partners(rows):
    assert curve(rows, "partners", "share, %") == [0, 0] + [100] * (FRAMES - 2)
    assert curve(rows, "partners", "age, frames") == [0, 0] + [5] * (FRAMES - 2)


@pytest.mark.parametrize("early", [False, True])
def test_lines_in_metres_move_with_the_camera(tmp_path, early):
    pose = np.array([[0, 0, 1, 4], [0, 1, 0, 5], [-1, 0, 0, 6], [0, 0, 0, 1]], float)
    with closing(RerunSink(save=tmp_path / "run.rrd")) as sink:
        for number, result in enumerate(pairs(3)):
            if early and not number:
                sink.log_pose(pose)
            sink.write(result)
            if not early and number == 1:
                sink.log_pose(pose)
    rows = recorded(tmp_path / "run.rrd")
    for entity in ("/camera", "/world/stereo"):
        assert [row[0] for row in rows[entity]["Transform3D:translation"] if row] == [[4, 5, 6]]
    assert {"Space", TRACKS, PARTNERS} < names_of_views(tmp_path / "run.rrd")


def test_layouts_have_both_images(path, rows, tmp_path):
    views = contents_of_views(path)
    assert views[PARTNERS] == {"/right/image", "/right/tracks"}
    assert {TRACKS, "Space", "With a partner", "Edges"} < views.keys()
    record(tmp_path / "full.rrd", pairs(1), blueprint="full")
    assert contents_of_views(tmp_path / "full.rrd")[PARTNERS] == {"/right/image", "/right/tracks", "/right/tracks/rest"}
    record(tmp_path / "minimal.rrd", pairs(1), blueprint="minimal", image="none")
    views = contents_of_views(tmp_path / "minimal.rrd")
    assert views.keys() == {TRACKS, PARTNERS, "Lines per frame", "Log"}
    assert views[PARTNERS] == {"/right/tracks"}
    wide = {kind: layout(kind, (1241, 376), right=True).root_container.contents[0] for kind in ("minimal", "default")}
    assert (type(wide["minimal"]), type(wide["default"])) == (rrb.Vertical, rrb.Horizontal)


def test_without_calibration_there_are_partners_and_no_metres(tmp_path):
    rows = record(tmp_path / "run.rrd", pairs(camera=None), descriptor_every=0)
    assert rows.keys() >= RIGHT
    assert not any(name.startswith("/world") for name in rows)
    assert "Space" not in names_of_views(tmp_path / "run.rrd")


def test_a_pair_without_lines_clears_what_was_shown(tmp_path):
    first, second = pairs(2)
    confirmed = replace(first, tracks=replace(first.tracks, states=np.ones(4, np.uint8)))
    empty = replace(second.tracks.take(np.zeros(4, bool)), reset="a gap")
    rows = record(tmp_path / "run.rrd", [confirmed, replace(second, tracks=empty)])
    for entity, kind in {"/right/tracks": "LineStrips2D:strips", "/world/stereo": "LineStrips3D:strips"}.items():
        assert [bool(row) for row in rows[entity][kind]] == [True, False]


def test_a_layer_has_nothing_of_the_right_image(tmp_path):
    ids = {"recording_id": "drive-1", "application_id": "drives", "layer": "cam0/lines"}
    rows = record(tmp_path / "run.rrd", pairs(), **ids)
    assert {name for name in rows if not name.startswith("/__")} == {"/cam0/lines/tracks", "/cam0/lines/tails"}


def test_plain_pictures_have_both_sides_in_the_same_colours(tmp_path):
    record(tmp_path / "run.rrd", pairs())
    save_overlay(tmp_path / "run.rrd", tmp_path / "picture.png", frame=8)
    picture = cv2.imread(str(tmp_path / "picture.png")).astype(int)
    assert picture.shape == (HEIGHT, 2 * WIDTH, 3)
    places = np.rint(rectangle(8).mean(axis=1)).astype(int)
    for (x, y), colour in zip(places[:2], track_colours(np.arange(2))[:, ::-1], strict=True):
        for column in (x, x + WIDTH - DISPARITY):
            beside = picture[y - 1 : y + 2, column - 1 : column + 2]
            assert np.abs(beside - colour).max(axis=2).min() < 40
    x, y = places[3]
    assert np.ptp(picture[y, x + WIDTH - DISPARITY - 9 : x + WIDTH - DISPARITY + 9], axis=1).max() < 12, "grey"


def test_a_recording_that_refers_to_the_left_video_has_partners_on_a_dark_picture(tmp_path):
    write_film(tmp_path / "clip.mp4", [result.frame.image for result in pairs()], 30)
    rows = record(tmp_path / "run.rrd", pairs(camera=None), image="video", video=tmp_path / "clip.mp4")
    assert "/right/image" not in rows
    frame = list(Recording(tmp_path / "run.rrd").frames())[8]
    left, right = frame.images
    assert left.shape == right.shape == (HEIGHT, WIDTH, 3)
    assert (right == BACKGROUND).all()
    assert [len(strips.points) for strips in frame.panels[1]] == [2]


def test_files_with_partners_are_replayed_with_them(tmp_path, monkeypatch):
    monkeypatch.setattr("logs.read_tracks", lambda path: (result.tracks for result in pairs()))
    assert command(tmp_path / "run.parquet", "--save", tmp_path / "out.rrd", main=main).code == 0
    rows = recorded(tmp_path / "out.rrd")
    assert rows["/right/tracks"]["track_id"] == rows["/camera/tracks"]["track_id"]
    assert curve(rows, "partners", "age, frames")[-1] == 5
    assert {TRACKS, PARTNERS} < names_of_views(tmp_path / "out.rrd")


@needs_viewer
def test_the_viewer_shows_lines_in_space_before_the_camera_and_has_no_complaints(path, rows, tmp_path):
    assert save_picture(path, tmp_path / "picture.png", frame=8, size=(1600, 1000)) == []
    picture = cv2.imread(str(tmp_path / "picture.png")).astype(int)
    near = np.abs(picture - track_colours(np.array([1]))[0, ::-1]).max(axis=2) < 12
    assert near[:460, :800].sum() > 50, "left"
    assert near[:460, 800:].sum() > 50, "right"
    y, x = np.nonzero(near[460:780, :800])
    assert np.ptp(y) > 3 * np.ptp(x) > 0, "upright in the space below"

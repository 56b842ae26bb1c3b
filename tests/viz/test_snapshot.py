"""Pictures and films of a recording, plain ones and of the real viewer."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun as rr

from airline.errors import InputError
from frontend.colours import track_colours
from tests.helpers.made_tracks import clip_results
from tests.helpers.moving_rectangle import HEIGHT, STEP_NS, WIDTH, frame_results, rectangle
from tests.helpers.viewer import FRAMES, RERUN, needs_viewer, record, snapshot
from viz.lines import TrackLog
from viz.overlay import write_film
from viz.recording import BACKGROUND, Recording
from viz.snapshot import headless_viewer, save_film, save_overlay, save_picture, show_frame, wait_until_loaded

NO_DRIVER = {"VK_DRIVER_FILES": "/none", "VK_ICD_FILENAMES": "/none"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("snapshot") / "run.rrd"
    record(path)
    return path


def drawn(path: Path, frame: int | None = None) -> np.ndarray:
    picture = path.with_suffix(".png")
    save_overlay(path, picture, frame=frame)
    return cv2.imread(str(picture))


def sides(frame: int) -> np.ndarray:
    """(4, 2) middles of the rectangle's sides, px; tracks 0 to 3."""
    return rectangle(frame).mean(axis=1)


@pytest.mark.parametrize("frame", [0, 8])
def test_confirmed_lines_and_no_others_have_the_colours_of_the_recording(recording, frame):
    picture = drawn(recording, frame).astype(int)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    tracks = list(frame_results(FRAMES))[frame].tracks
    colours = track_colours(tracks.ids)[:, ::-1]
    for middle, colour, confirmed in zip(sides(frame), colours, tracks.confirmed, strict=True):
        x, y = np.rint(middle).astype(int)
        assert (np.abs(picture[y - 1 : y + 2, x - 1 : x + 2] - colour).max(axis=2).min() < 40) == confirmed
    x, y = np.rint(sides(frame).mean(axis=0)).astype(int)
    assert np.abs(picture[y, x] - 150).max() < 8  # the image itself


@contextmanager
def stream_into(path: Path) -> Iterator[rr.RecordingStream]:
    """A recording that somebody else writes."""
    stream = rr.RecordingStream("test")
    stream.save(path)
    yield stream
    stream.flush()
    stream.disconnect()


def lines_alone(path: Path, **camera: float) -> Path:
    """A recording with tracks and without images."""
    with stream_into(path) as stream:
        if camera:
            stream.log("/camera", rr.Pinhole(focal_length=300, **camera), static=True)
        tracks = TrackLog(stream)
        for k, result in enumerate(frame_results(FRAMES)):
            stream.set_time("frame", sequence=k)
            tracks.write(result.tracks, (WIDTH, HEIGHT))
    return path


def test_lines_are_drawn_between_pixels_and_bold_ones_wider(tmp_path, monkeypatch):
    monkeypatch.setattr("viz.lines.BOLD_LINES", 1)
    monkeypatch.setattr("viz.lines.BOLD_RADIUS", 0.005)
    picture = drawn(lines_alone(tmp_path / "lines.rrd", width=WIDTH, height=HEIGHT), 8)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    widths = []
    for axis, side in zip((1, 0), sides(8), strict=False):  # the upper and the right one, both confirmed
        x, y = np.rint(side).astype(int) + ((20, 0) if axis else (0, 20))  # off the tail
        across = picture[y - 6 : y + 7, x] if axis else picture[y, x - 6 : x + 7]
        profile = np.abs(across.astype(float) - BACKGROUND).sum(axis=1)
        place = (y if axis else x) - 6 + np.average(np.arange(13), weights=profile)
        assert place == pytest.approx(side[axis], abs=0.15)
        widths.append((profile > 0.5 * profile.max()).sum())
    assert widths[0] > widths[1]


def test_background_is_as_large_as_the_lines_need_without_a_camera(tmp_path):
    picture = drawn(lines_alone(tmp_path / "lines.rrd"), 8)
    assert picture.shape[1::-1] == pytest.approx(rectangle(8).reshape(-1, 2).max(axis=0), abs=2)
    assert (picture.reshape(-1, 3) == BACKGROUND).all(axis=1).mean() > 0.9


@pytest.mark.parametrize(("mode", "shape"), [("raw", (3,)), ("raw", ()), ("video", (3,))])
def test_images_in_every_form(tmp_path, mode, shape):
    images = [np.full((HEIGHT, WIDTH, *shape), 20 * k + 10, np.uint8) for k in range(FRAMES)]
    write_film(tmp_path / "film.mp4", [np.full((HEIGHT, WIDTH, 3), image.max()) for image in images], 30)
    results = [replace(r, frame=replace(r.frame, image=i)) for r, i in zip(frame_results(FRAMES), images, strict=True)]
    record(tmp_path / "run.rrd", results, image=mode, video=tmp_path / "film.mp4")
    shown = [frame.images[0] for frame in Recording(tmp_path / "run.rrd").frames()]
    assert len(shown) == FRAMES
    for image, expected in zip(shown, images, strict=True):
        assert np.abs(image.astype(int) - expected.max()).max() < 6


@pytest.mark.skipif(not RERUN.exists(), reason="Rerun's programs are not installed beside this Python")
def test_an_optimized_recording_is_drawn_the_same(tmp_path):
    """There lines and what else is known of them may be in chunks of their own."""
    run, optimized = tmp_path / "run.rrd", tmp_path / "optimized.rrd"
    record(run, clip_results())
    subprocess.run([RERUN, "rrd", "optimize", run, "-o", optimized], check=True, capture_output=True)
    for frame in (2, None):
        np.testing.assert_array_equal(drawn(optimized, frame), drawn(run, frame))


def film_of(path: Path) -> tuple[list[np.ndarray], float]:
    """Frames, and how many of them in a second."""
    film = cv2.VideoCapture(str(path))
    frames = []
    while (read := film.read())[0]:
        frames.append(read[1])
    return frames, film.get(cv2.CAP_PROP_FPS)


def test_film_has_the_frames_and_the_rate_of_the_recording(recording, tmp_path):
    assert save_film(recording, tmp_path / "film.mp4") == FRAMES
    frames, rate = film_of(tmp_path / "film.mp4")
    assert rate == pytest.approx(1e9 / STEP_NS, rel=1e-3)
    assert len(frames) == FRAMES
    assert np.abs(frames[8].astype(int) - drawn(recording, 8)).mean() < 4
    assert save_film(recording, tmp_path / "part.mp4", start=3, end=5) == 3
    with pytest.raises(InputError, match="choose frames from 0 to 9"):
        save_film(recording, tmp_path / "part.mp4", start=12)


def test_odd_sizes_make_a_film_too(tmp_path):
    write_film(tmp_path / "odd.mp4", [np.full((31, 45, 3), 80, np.uint8)] * 2, 12.5)
    (first, _), rate = film_of(tmp_path / "odd.mp4")
    assert (first.shape, rate) == ((32, 46, 3), pytest.approx(12.5))


def test_command_line_without_a_graphics_driver(recording, tmp_path):
    film, picture = tmp_path / "film.mp4", tmp_path / "picture.png"
    outcome = snapshot(recording, picture, "--plain", "--frame", 8, "--video", film, "--end", 4, **NO_DRIVER)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    np.testing.assert_array_equal(cv2.imread(str(picture)), drawn(recording, 8))
    assert film.stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["picture.png", "--plain", "--frame", "99"], "there is no frame 99: choose one from 0 to 9"),
        (["none/picture.png", "--plain"], "cannot write"),
        (["picture.xyz", "--plain"], "cannot write"),
        (["--video", "film.avi"], "films are .mp4 files"),
        (["--video", "none/film.mp4"], "cannot write the film"),
        ([], "name the picture to write"),
    ],
)
def test_wrong_arguments_are_answered_in_one_sentence(recording, tmp_path, arguments, sentence):
    given = [str(tmp_path / part) if "." in part else part for part in arguments]
    outcome = snapshot(recording, *given)
    assert outcome.returncode == 2
    assert sentence in outcome.stderr
    assert outcome.stderr.count("\n") == 1


@needs_viewer
@pytest.mark.parametrize(
    ("name", "frame", "environment", "sentence"),
    [
        ("run.rrd", 99, {}, "error: there is no frame 99: choose one from 0 to 9"),
        ("bad.rrd", 0, {}, "damaged or was cut short"),
        ("run.rrd", 0, NO_DRIVER, "install a Vulkan driver, such as Debian's mesa-vulkan-drivers, or take a plain"),
        ("none.rrd", 0, {}, "there is no recording"),
    ],
)
def test_what_the_viewer_cannot_show_is_said(recording, tmp_path, name, frame, environment, sentence):
    (recording.parent / "bad.rrd").write_bytes(b"no recording" * 100)
    outcome = snapshot(recording.parent / name, tmp_path / "picture.png", "--frame", frame, **environment)
    assert outcome.returncode == 2
    assert sentence in outcome.stderr


def test_recordings_of_others_and_damaged_ones(tmp_path):
    with stream_into(tmp_path / "other.rrd") as stream:
        stream.set_time("frame", sequence=0)
        stream.log("/points", rr.Points2D([[1, 2]]))
    (tmp_path / "bad.rrd").write_bytes(b"no recording" * 100)
    for name, says in (("other", "has no tracks"), ("bad", "damaged or none"), ("none", "there is no recording")):
        with pytest.raises(InputError, match=says):
            Recording(tmp_path / f"{name}.rrd")


@needs_viewer
def test_viewer_shows_the_tracks_and_has_no_complaints(recording, tmp_path):
    complaints = save_picture(recording, tmp_path / "picture.png", frame=8, size=(1280, 800))
    assert complaints == []
    picture = cv2.imread(str(tmp_path / "picture.png"))
    assert picture.shape == (800, 1280, 3)
    assert picture.std() > 20
    tracks = list(frame_results(FRAMES))[8].tracks
    for colour in track_colours(tracks.ids[tracks.confirmed])[:, ::-1]:
        near = np.abs(picture.astype(int) - colour).max(axis=2) < 12
        assert near.sum() > 50, f"no line in the colour {colour}"


@needs_viewer
def test_regions_have_their_tracks_colour_whatever_was_shown_first(tmp_path):
    """Ids grow, and the viewer went on with the scale of the classes in the frame that it showed first."""
    grown = [
        replace(r, tracks=replace(r.tracks, ids=r.tracks.ids + 700 * r.frame.index)) for r in frame_results(FRAMES)
    ]
    record(tmp_path / "run.rrd", grown)
    with headless_viewer(tmp_path / "run.rrd", (1280, 800), 60) as client:
        state = wait_until_loaded(client, tmp_path / "run.rrd")
        for frame in (1, 8):
            show_frame(client, state, frame, tmp_path / "picture.png")
    beside = cv2.imread(str(tmp_path / "picture.png"))[:560, 780:].astype(int)  # of the view with the tracks
    colour = track_colours(np.array([8 * 700]))[0, ::-1]
    assert (np.abs(beside - colour).max(axis=2) < 12).sum() > 50

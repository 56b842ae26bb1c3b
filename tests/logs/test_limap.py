"""The LIMAP folder, read as LIMAP reads it: its text formats and loading order, written down again here."""

from __future__ import annotations

import csv
from dataclasses import replace

import cv2
import numpy as np
import pytest

from airline.errors import ConfigError, InputError
from logs.colmap import main as colmap_main
from logs.repair import main
from logs.sinks.limap import LimapTrackSink, listed
from logs.sinks.open import check, open_track_sink
from tests.helpers.command import refusal
from tests.helpers.made_tracks import CAMERA, clip_results, made_tracks, result_of, write_all

SEGMENTS = "line_detections/lsd/segments"


def read_segments(folder):
    """Segments by image id: every file of the folder, its name from character 9 on, a count and lines of numbers."""
    found = {}
    for path in (folder / SEGMENTS).iterdir():
        lines = path.read_text().splitlines(keepends=True)
        count = int(lines[0].strip())
        assert count + 1 == len(lines)
        found[int(path.name[9:-4])] = np.array([[float(k) for k in line.strip().split(" ")] for line in lines[1:]])
    return found


def read_matches(folder, image, neighbours=20):
    path = folder / f"line_matchings/lsd/feats_lbd/lbd_n{neighbours}_top0/matches_{image}.npy"
    assert b"numpy._core" not in path.read_bytes(), "NumPy 1 knows no such module"
    return np.load(path, allow_pickle=True).item()


def read_neighbours(folder):
    lines = (folder / "metainfos.txt").read_text().splitlines()
    count = int(lines[0].strip().split(",")[1])
    ranges = [[float(k) for k in line.strip().split(",")[1:]] for line in lines[1:4]]
    assert ranges == [[-np.inf, np.inf]] * 3
    assert len(lines) == 4 + count
    parts = [line.strip().split(",") for line in lines[4:]]
    return {int(part[0][6:]): [int(k) for k in part[1:]] for part in parts}


def write(folder, stream, **options):
    write_all(LimapTrackSink(folder, **options), stream)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "limap"
    return write(folder, [result.tracks for result in clip_results()])


def test_segments_have_their_origin_at_the_pixels_corner(folder):
    segments = read_segments(folder)
    assert segments.keys() == set(range(1, 13))
    for result in clip_results():
        tracks = result.tracks
        np.testing.assert_allclose(segments[tracks.frame_index + 1], tracks.segments_px.reshape(-1, 4) + 0.5, atol=6e-5)


def test_matches_are_rows_of_the_same_track(folder):
    ids = {result.tracks.frame_index + 1: result.tracks.ids for result in clip_results()}
    neighbours = read_neighbours(folder)
    for image in ids:
        written = np.loadtxt(folder / f"track_ids/track_ids_{image}.txt", np.int64)
        np.testing.assert_array_equal(written, ids[image])
        matches = read_matches(folder, image)
        assert (
            set(matches) == set(neighbours[image]) == {k for k in range(image - 10, image + 11) if k in ids} - {image}
        )
        for other, pairs in matches.items():
            assert pairs.dtype == np.int32
            assert pairs.shape == (len(np.intersect1d(ids[image], ids[other])), 2)
            np.testing.assert_array_equal(ids[image][pairs[:, 0]], ids[other][pairs[:, 1]])
    assert len(read_matches(folder, 5)[6]) > 50


def test_matches_are_complete_while_it_runs(tmp_path):
    rng = np.random.default_rng(0)
    sink = LimapTrackSink(tmp_path / "limap", neighbours=4)
    frames = [3, 5, 6, 9, 10, 20]
    for frame in frames:
        sink.write(result_of(made_tracks(frame, frame, rng.choice(40, 20, replace=False), rng)))
        done = [int(line.split(",")[0]) for line in (tmp_path / "limap/images.csv").read_text().splitlines()[1:]]
        assert done == [one + 1 for one in frames[: len(done)]]
        assert done[-1] == frame + 1
        for k, image in enumerate(done):
            before, after = set(done[max(k - 2, 0) : k]), set(done[k + 1 : k + 3])
            assert set(read_matches(tmp_path / "limap", image, 4)) in (before, before | after)
    sink.close()
    assert read_neighbours(tmp_path / "limap") == {
        4: [6, 7], 6: [4, 7, 10], 7: [4, 6, 10, 11], 10: [6, 7, 11, 21], 11: [7, 10, 21], 21: [10, 11]
    }  # fmt: skip
    assert set(read_matches(tmp_path / "limap", 7, 4)) == {4, 6, 10, 11}
    (tmp_path / "limap/metainfos.txt").unlink()
    assert main([str(tmp_path / "limap")]) == 0  # python -m logs.repair
    assert read_neighbours(tmp_path / "limap")[21] == [10, 11]


def test_lines_are_undistorted_for_the_camera_in_the_folder(tmp_path):
    tracks = made_tracks(0, 0, np.arange(30), np.random.default_rng(0))
    write(tmp_path / "limap", [tracks])
    camera_id, model, *numbers = (tmp_path / "limap/cameras.txt").read_text().split()
    assert (camera_id, model) == ("1", "PINHOLE")
    width, height, fx, fy, cx, cy = map(float, numbers)
    assert (width, height, cx, cy) == (320, 240, CAMERA.cx + 0.5, CAMERA.cy + 0.5)
    found = read_segments(tmp_path / "limap")[1].reshape(-1, 2)
    rays = np.column_stack([(found[:, 0] - cx) / fx, (found[:, 1] - cy) / fy, np.ones(len(found))])
    zero = np.zeros(3)
    pixels = cv2.projectPoints(rays.reshape(-1, 1, 3), zero, zero, CAMERA.matrix, CAMERA.coefficients)[0]
    np.testing.assert_allclose(pixels.reshape(-1, 2, 2), tracks.segments_px, atol=1e-3)


def test_lines_that_cannot_be_undistorted_are_left_out(tmp_path):
    camera = replace(CAMERA, distortion="equidistant", coefficients=np.zeros(4))
    rng = np.random.default_rng(0)
    stream = [made_tracks(k, k, np.arange(5), rng, camera=camera) for k in range(2)]
    stream[0].segments_px[2, 1] = 1e5
    write(tmp_path / "limap", stream)
    assert len(read_segments(tmp_path / "limap")[1]) == 4
    assert read_matches(tmp_path / "limap", 1)[2].tolist() == [[0, 0], [1, 1], [2, 3], [3, 4]]


def test_files_of_an_earlier_run_go_and_others_stay(tmp_path):
    stream = [made_tracks(k, k, np.arange(3), np.random.default_rng(0)) for k in range(5)]
    write(tmp_path / "limap", stream)
    (tmp_path / "limap/notes.txt").write_text("mine")
    write(tmp_path / "limap", stream[:2], overwrite=True)
    assert read_segments(tmp_path / "limap").keys() == {1, 2}
    assert set(read_neighbours(tmp_path / "limap")) == {1, 2}
    assert (tmp_path / "limap/notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["cameras.txt", "images.csv", "metainfos.txt"])
def test_files_of_somebody_else_under_our_names_stay(tmp_path, name):
    (tmp_path / name).write_text("theirs")
    for refused in (check, open_track_sink):
        with pytest.raises(InputError, match=f"holds a {name} that is of something else"):
            refused(f"limap:{tmp_path}", overwrite=True)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "theirs")]


ODD_NAMES = [" e .png", "a\rb.png", 'b,"c\nd.png', "f\udcff.png", '"', "\r\n", "'", "\u2028\x1c.png"]


def test_any_name_is_read_back(tmp_path):
    sink = LimapTrackSink(tmp_path / "limap", neighbours=4)
    for k, name in enumerate(ODD_NAMES):
        sink.add(k + 1, name, k, np.zeros((0, 4)), np.zeros(0, np.int64))
    sink.close()
    with (tmp_path / "limap/images.csv").open(encoding="utf-8", errors="surrogateescape", newline="") as file:
        assert list(csv.reader(file))[1:] == [[f"{k + 1}", f"{k}", name] for k, name in enumerate(ODD_NAMES)]
    assert [name for *_, name in listed(tmp_path / "limap")] == ODD_NAMES
    assert read_neighbours(tmp_path / "limap").keys() == set(range(1, len(ODD_NAMES) + 1))


@pytest.mark.parametrize(
    "row",
    [
        "",
        "4",
        "4,5",
        "4,5,a,b",
        "x,5,a",
        "../4,5,a",
        "0,5,a",
        "4,x,a",
        '4,5,"a',
        '4,5,"a"b',
        "4,5,a\rb",
        "4,5," + 140_000 * "a",
    ],
)
def test_a_damaged_list_of_images_is_one_sentence(tmp_path, row):
    folder = write(tmp_path / "limap", [made_tracks(0, 0, np.arange(3), np.random.default_rng(0))])
    with (folder / "images.csv").open("ab") as file:
        file.write(f"{row}\n".encode())
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 000000.png\n\n")
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 9 9 1 1 1 1\n")
    for error in (
        refusal(folder, main=main),
        refusal(folder, tmp_path, "--out", tmp_path / "out", main=colmap_main),
    ):
        assert "images.csv': " in error


@pytest.mark.parametrize(
    ("frame", "camera", "complaint"),
    [
        (5, replace(CAMERA, fx=3.0), "camera changes"),
        (5, None, "camera is known for some frames only"),
        (4, CAMERA, "frame 4 follows frame 4"),
    ],
)
def test_what_the_layout_cannot_hold(tmp_path, frame, camera, complaint):
    stream = [
        made_tracks(number, number, np.arange(3), np.random.default_rng(0), camera=one)
        for number, one in ((4, CAMERA), (frame, camera))
    ]
    with pytest.raises(InputError, match=complaint):
        write(tmp_path / "limap", stream)


def test_a_camera_that_comes_later_is_refused(tmp_path):
    stream = [
        made_tracks(k, k, np.arange(3), np.random.default_rng(0), camera=one) for k, one in enumerate((None, CAMERA))
    ]
    with pytest.raises(InputError, match="camera is known for some frames only"):
        write(tmp_path / "limap", stream)
    assert not (tmp_path / "limap/cameras.txt").exists()


def test_neighbours_come_in_pairs(tmp_path):
    with pytest.raises(ConfigError, match="even"):
        LimapTrackSink(tmp_path / "a", neighbours=3)

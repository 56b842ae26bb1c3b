"""LIMAP's folder for a COLMAP model: ids by name, images that are missing, cameras. pycolmap is the other reader.

pycolmap runs in processes of its own: it and OpenCV bring copies of one library that break each other.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airline.errors import InputError
from airline.scenes import RenderedClip
from frontend.sources.folder import FolderSource
from logs import colmap
from logs.colmap import main, read_model
from logs.sinks.limap import LimapTrackSink
from tests.helpers.made_tracks import CAMERA, clip_results, made_tracks, result_of, write_all, write_tracks
from tests.logs.test_limap import read_matches, read_segments

pytest.importorskip("pycolmap", reason="pycolmap is not installed: it comes with the extra 'dev'")

SHUFFLED = [40, 7, 13, 2, 25, 1]  # the model's ids of frames 0, 2, 4, ...
PINHOLE = "9 PINHOLE 700 500 301.5 330.25 340.0 251.0"


def pycolmap(code: str, *arguments: object) -> str:
    """What a program prints that reads or writes with pycolmap."""
    command = [sys.executable, "-c", f"import json, pycolmap, sys\n{code}", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def write_model(folder: Path, camera: str, images: dict[int, str], poses: np.ndarray | None = None) -> Path:
    """A model in COLMAP's text form: images by id, (N, 4, 4) world_from_camera of each."""
    folder.mkdir(parents=True)
    rows = ["# image list\n"]
    for k, (image, name) in enumerate(images.items()):
        pose = np.eye(4) if poses is None else np.linalg.inv(poses[k])
        half = cv2.Rodrigues(pose[:3, :3])[0].ravel() / 2
        axis = half * np.sinc(np.linalg.norm(half) / np.pi)
        numbers = (np.cos(np.linalg.norm(half)), *axis, *pose[:3, 3])
        rows.append(f"{image} {' '.join(map(repr, map(float, numbers)))} {camera.split()[0]} {name}\n\n")
    (folder / "images.txt").write_text("".join(rows))
    (folder / "cameras.txt").write_text(f"# cameras\n{camera}\n")
    (folder / "points3D.txt").write_text("")
    return folder


def to_binary(model: Path, out: Path) -> Path:
    out.mkdir()
    pycolmap("pycolmap.Reconstruction(sys.argv[1]).write_binary(sys.argv[2])", model, out)
    return out


PROJECTIONS = """
model = pycolmap.Reconstruction(sys.argv[1])
print(json.dumps({k: (model.cameras[image.camera_id].calibration_matrix() @ image.cam_from_world().matrix()).tolist()
                  for k, image in model.images.items()}))
"""


def misses(folder: Path, model: Path) -> np.ndarray:
    """How far (px) lines in space are from the segments of four images and more that they were found from.

    Everything is loaded as LIMAP loads it: images, cameras and poses of the model, segments and matches by its ids.
    """
    projections = {int(k): np.array(P) for k, P in json.loads(pycolmap(PROJECTIONS, model)).items()}
    segments = {k: one.reshape(-1, 2, 2) for k, one in read_segments(folder).items()}
    segments = {k: np.dstack([segments[k], np.ones(segments[k].shape[:2])]) for k in projections}  # each has a file
    found = []
    for image, projection in projections.items():
        views: dict[int, list[tuple[int, int]]] = {}
        for other, pairs in read_matches(folder, image).items():
            for row, other_row in pairs.tolist():
                views.setdefault(row, [(image, row)]).append((other, other_row))
        for row, seen in views.items():
            if len(seen) >= 4:
                planes = np.array([np.cross(*segments[k][r]) @ projections[k] for k, r in seen])
                planes /= np.linalg.norm(planes[:, :3], axis=1)[:, None]
                points = np.linalg.svd(planes)[2][2:]
                line = np.cross(*(points @ projection.T))
                found.append(np.abs(segments[image][row] @ line).max() / np.linalg.norm(line[:2]))
    return np.array(found)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The folder of the clip, and a model of every other frame, under other ids and of another camera's pixels."""
    folder = tmp_path_factory.mktemp("clip")
    write_tracks(LimapTrackSink(folder / "limap"), clip_results())
    frames = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=12, size=(320, 240))
    poses = np.array([frames.render(2 * k).pose for k in range(6)])
    images = {number: f"{2 * k:06d}.png" for k, number in enumerate(SHUFFLED)}
    return folder / "limap", write_model(folder / "sparse", PINHOLE, images, poses)


@pytest.mark.parametrize("binary", [False, True])
def test_lines_of_a_model_of_some_images_meet_in_space(clip, tmp_path: Path, binary: bool, capsys) -> None:
    folder, model = clip
    given = to_binary(model, tmp_path / "binary") if binary else model
    assert main([str(folder), str(given), "--out", str(tmp_path / "out")]) == 0
    assert "6 images of the model have lines, 0 have none" in capsys.readouterr().out
    assert read_segments(tmp_path / "out").keys() == set(SHUFFLED)
    assert all(read_matches(tmp_path / "out", k).keys() == {*SHUFFLED} - {k} for k in SHUFFLED)
    found = misses(tmp_path / "out", model)
    assert len(found) > 100
    assert np.median(found) < 0.5


def test_without_it_lines_do_not_meet(clip, tmp_path: Path) -> None:
    folder, _ = clip
    model = write_model(tmp_path / "model", PINHOLE, {2 * k + 1: f"{2 * k:06d}.png" for k in range(6)})
    with pytest.raises(KeyError):  # LIMAP would read memory that is not its own
        misses(folder, model)


def test_images_of_the_model_that_have_no_lines_have_files(tmp_path: Path) -> None:
    stream = [made_tracks(k, k, np.arange(5), np.random.default_rng(k), camera=None) for k in range(4)]
    write_all(LimapTrackSink(tmp_path / "limap", neighbours=4), stream)
    model = write_model(tmp_path / "model", PINHOLE, {5: "000003.png", 2: "other.png", 8: "000001.png"})
    assert main([str(tmp_path / "limap"), str(model), "--out", str(tmp_path / "out")]) == 0
    assert {k: len(one) for k, one in read_segments(tmp_path / "out").items()} == {8: 5, 5: 5, 2: 0}
    assert {k: len(v) for k, v in read_matches(tmp_path / "out", 8, 4).items()} == {5: 5, 2: 0}
    assert (tmp_path / "out/images.csv").read_text().splitlines()[1:] == [
        '8,1,"000001.png"',
        '5,3,"000003.png"',
        '2,,"other.png"',
    ]
    np.testing.assert_array_equal(read_segments(tmp_path / "out")[8], read_segments(tmp_path / "limap")[2])


IMPORTED = """
pycolmap.Database.open(sys.argv[1]).close()
pycolmap.import_images(sys.argv[1], sys.argv[2])
with pycolmap.Database.open(sys.argv[1]) as database:
    print(json.dumps({image.name: image.image_id for image in database.read_all_images()}))
"""


def test_ids_and_names_are_those_of_colmaps_import(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for digits, folder in (("03", tmp_path / "sorted"), ("", tmp_path / "as people count")):
        folder.mkdir()
        for k in range(12):
            cv2.imwrite(f"{folder}/left, {k:{digits}}.png", np.full((24, 32), k, np.uint8))
        frames = list(FolderSource(folder))
        made = [made_tracks(k, k, np.arange(3), np.random.default_rng(k), points=0) for k in range(12)]
        results = [replace(result_of(one), frame=frame) for one, frame in zip(made, frames, strict=True)]
        caplog.clear()
        write_tracks(LimapTrackSink(folder / "limap"), results)
        rows = np.loadtxt(folder / "limap/images.csv", str, delimiter=",", skiprows=1, quotechar='"', usecols=(0, 2))
        ours = {name: int(image) for image, name in rows}
        theirs = json.loads(pycolmap(IMPORTED, tmp_path / f"{folder.name}.db", folder))
        assert ours.keys() == theirs.keys()
        assert (ours == theirs) == (digits != "")
        assert [record.getMessage().split(":")[0] for record in caplog.records] == (
            [] if digits else ["COLMAP sorts 'left, 10.png' before 'left, 9.png'"]
        )


CAMERAS = """
camera, = pycolmap.Reconstruction(sys.argv[1]).cameras.values()
print(json.dumps([camera.camera_id, camera.model.name, camera.width, camera.height, list(camera.params)]))
"""


def test_colmap_reads_the_camera(tmp_path: Path) -> None:
    write_all(LimapTrackSink(tmp_path / "limap"), [made_tracks(0, 0, np.arange(3), np.random.default_rng(0))])
    for name in ("images.txt", "points3D.txt"):
        (tmp_path / "limap" / name).write_text("")
    numbers = [CAMERA.fx, CAMERA.fy, CAMERA.cx + 0.5, CAMERA.cy + 0.5]
    assert json.loads(pycolmap(CAMERAS, tmp_path / "limap")) == [1, "PINHOLE", 320, 240, numbers]


def test_what_does_not_belong_together_is_refused(clip, tmp_path: Path, capsys) -> None:
    folder, model = clip
    lens = write_model(tmp_path / "lens", "1 OPENCV 9 9 1 1 1 1 0 0 0 0", {1: "000000.png"})
    others = write_model(tmp_path / "others", PINHOLE, {1: "cam0/000000.png"})
    (tmp_path / "older").mkdir()
    for name in ("line_detections", "line_matchings"):
        (tmp_path / "older" / name).symlink_to(folder / name)
    (tmp_path / "older/images.csv").write_text("image_id,stamp_ns\n0,0\n")
    for path, other, out, complaint in (
        (folder, lens, "out", "camera (OPENCV) has a lens: give the model that colmap image_undistorter writes"),
        (folder, to_binary(lens, tmp_path / "binary"), "out", "camera (model 4) has a lens"),
        (folder, others, "out", "which has 'cam0/000000.png': images.csv must have the same names"),
        (folder, tmp_path, "out", "cannot read a COLMAP model"),
        (tmp_path, model, "out", "is no folder of tracks for LIMAP"),
        (tmp_path / "older", model, "out", "row 2 is no image's id, stamp and name"),
        (folder, model, folder, "is the folder that is read"),
        (folder, model, model, "is the folder that is read"),
        (folder, model, tmp_path / "others", "holds files"),
    ):
        assert main([str(path), str(other), "--out", str(tmp_path / out)]) == 2
        assert complaint in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_model_given_as_the_output_is_kept(clip, tmp_path: Path, capsys) -> None:
    folder, _ = clip
    model = write_model(tmp_path / "model", PINHOLE, {1: "000000.png"})
    other = write_model(tmp_path / "other", PINHOLE, {1: "000000.png"})
    before = (model / "cameras.txt").read_bytes()
    for out in (model, other):
        assert main([str(folder), str(model), "--out", str(out), "--overwrite"]) == 2
        assert "choose another" in capsys.readouterr().err
        assert (out / "cameras.txt").read_bytes() == before
        assert not (out / "line_detections").exists()


TWO = {3: "b.png", 900: "c/d.png"}


def edited(folder: Path, name: str, old: str, new: str) -> Path:
    """A text model with one thing changed."""
    model = write_model(folder, PINHOLE, TWO)
    text = (model / name).read_text()
    assert old in text
    (model / name).write_text(text.replace(old, new))
    return model


@pytest.mark.parametrize(
    ("name", "old", "new", "complaint"),
    [
        *(("cameras.txt", "301.5", word, "no camera has the numbers") for word in ("nan", "inf", "0", "-3", "1e300")),
        ("cameras.txt", "251.0", "-2e9", "no camera has the numbers"),
        ("cameras.txt", "251.0", "2_5", "'2_5' is no number"),
        ("cameras.txt", PINHOLE, f"{PINHOLE}\n{PINHOLE}", "camera 9 is there twice"),
        ("cameras.txt", "9 PIN", "8 PIN", "has camera 9, which is not there"),
        ("images.txt", "900 ", "3 ", "image id 3 is there twice"),
        ("images.txt", "900 ", "0 ", "has the id 0"),
        ("images.txt", "900 ", "-5 ", "has the id -5"),
        ("images.txt", "900 ", "2147483648 ", "has the id 2147483648"),
        ("images.txt", "900 ", "9_00 ", "'9_00' is no number"),
        ("images.txt", "900 ", "\u0669 ", "is no number"),
        ("images.txt", "c/d.png", "b.png", "name 'b.png' is there twice"),
        ("images.txt", "b.png\n", "b.png", "is not its points"),
        ("images.txt", " 9 b.png", "", "is no image"),
    ],
)
def test_models_that_make_no_sense(tmp_path: Path, name: str, old: str, new: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        read_model(edited(tmp_path / "model", name, old, new))


def test_a_model_without_images(tmp_path: Path) -> None:
    model = write_model(tmp_path / "model", PINHOLE, {})
    for one in (model, to_binary(model, tmp_path / "binary")):
        with pytest.raises(InputError, match="it has no images"):
            read_model(one)


def test_comments_are_indented_and_cameras_without_images_have_lenses(tmp_path: Path) -> None:
    sound = read_model(write_model(tmp_path / "sound", PINHOLE, TWO))
    lenses = "\n".join(
        ("  # lenses", "1 OPENCV 9 9 1 1 1 1 0 0 0 0", "2 SIMPLE_RADIAL 9 9 1 1 1 0", "10 FOV 9 9 1 1 1 1 0")
    )
    model = edited(tmp_path / "model", "cameras.txt", "# cameras", lenses)
    (model / "images.txt").write_text(f"  # images\n{(model / 'images.txt').read_text()}")
    for one in (model, to_binary(model, tmp_path / "binary")):
        for name, (image, (focal, centre)) in read_model(one).items():
            assert image == sound[name][0]
            np.testing.assert_array_equal((focal, centre), sound[name][1])


LENSES = """
model = pycolmap.Reconstruction()
names = [name for name in pycolmap.CameraModelId.__members__ if name != "INVALID"]
for k, name in enumerate(names, 1):
    model.add_camera(pycolmap.Camera.create_from_model_name(k, name, 9.0, 9, 9))
model.write_binary(sys.argv[1])
print(json.dumps(names))
"""


def test_every_model_of_colmaps_cameras_has_its_length(tmp_path: Path) -> None:
    names = json.loads(pycolmap(LENSES, tmp_path))
    assert [k for k, _ in colmap._binary_cameras(tmp_path / "cameras.bin")] == [*range(1, len(names) + 1)]


@pytest.mark.parametrize("name", ["images.bin", "cameras.bin"])
def test_a_binary_file_ends_where_it_says(tmp_path: Path, name: str) -> None:
    model = to_binary(write_model(tmp_path / "text", PINHOLE, TWO), tmp_path / "binary")
    whole = (model / name).read_bytes()
    if name == "images.bin":  # points of the last image, the first of which are cut off
        (model / name).write_bytes(whole[:-8] + (3).to_bytes(8, "little") + bytes(48))
        with pytest.raises(InputError, match="what it says that it holds"):
            read_model(model)
    (model / name).write_bytes(whole + b"\0")
    with pytest.raises(InputError, match="what it says that it holds"):
        read_model(model)


SMALL = """
import resource, sys
from pathlib import Path
from airline.errors import InputError
from logs.colmap import fit_to_model
resource.setrlimit(resource.RLIMIT_DATA, (2 * 2**30,) * 2)
for case in Path(sys.argv[1]).iterdir():
    try:
        fit_to_model(case / "limap", case / "model", case / "out")
    except InputError as error:
        print(error)
"""


def test_huge_files_fill_no_memory(clip, tmp_path: Path) -> None:
    text = write_model(tmp_path / "text", PINHOLE, TWO)
    binary = to_binary(text, tmp_path / "binary")
    names = ["images.bin", "cameras.bin", "images.txt", "cameras.txt", "images.csv"]
    for name, keeps in product(names, [True, False]):
        case = tmp_path / "cases" / f"{name}-{keeps}"
        shutil.copytree(binary if name.endswith("bin") else text, case / "model")
        shutil.copytree(clip[0], case / "limap")
        with (case / ("limap" if name == "images.csv" else "model") / name).open("r+b" if keeps else "wb") as file:
            file.truncate(30 * 10**9)  # takes no room on the disk
    command = [sys.executable, "-c", SMALL, str(tmp_path / "cases")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("cannot read") == done.stdout.count("\n") == 2 * len(names)


def samples(folder: Path) -> Callable[[str], bytes]:
    text = write_model(folder / "text", PINHOLE, {3: "b.png", 900: "c/d.png"})
    binary = to_binary(text, folder / "binary")
    assert read_model(text).keys() == read_model(binary).keys() == {"b.png", "c/d.png"}
    return lambda name: ((text if name.endswith("txt") else binary) / name).read_bytes()


@pytest.mark.parametrize("name", ["images.txt", "cameras.txt", "images.bin", "cameras.bin"])
def test_a_damaged_model_is_an_error_of_ours(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    whole = samples(tmp_path_factory.mktemp("sound"))
    folder = tmp_path_factory.mktemp("damaged")

    @given(st.integers(0, 10**6), st.binary(max_size=12))
    def damaged(place: int, other: bytes) -> None:
        for file in ("images", "cameras"):
            (folder / f"{file}{name[-4:]}").write_bytes(whole(f"{file}{name[-4:]}"))
        place %= len(whole(name))
        (folder / name).write_bytes(whole(name)[:place] + other + whole(name)[place + len(other) + 1 :])
        with suppress(InputError):
            read_model(folder)

    damaged()

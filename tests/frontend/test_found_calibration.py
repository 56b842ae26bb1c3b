"""Calibration that lies with the images, where data sets have it: what is taken, said, and left."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from frontend import LineFrontend, open_source
from frontend.batch import run_batch
from frontend.batch.plan import job_settings, make_plan
from frontend.camera.calibration import read_calibration
from frontend.cli.settings import InputConfig, RunConfig
from logs import read_tracks
from tests.frontend.test_calibration import DSO, EUROC, ICL, JSON, KALIBR, KITTI, KITTI_RAW, ROS, SCANNET, TUM
from tests.helpers.command import command

FOV = "0.349153 0.436593 0.493140 0.499021 0.933592\n1280 1024\ncrop\n640 480\n"  # of TUM's monocular data set
FIRST = 10**18  # ns

LAYOUTS = [  # where the images are, and their size; the calibration; the inputs, + for the former; which camera, its fx
    ("mav0/cam0/data", (752, 480), "mav0/cam0/sensor.yaml", EUROC, ["", "mav0", "mav0/cam0", "+"], "", 458.654),
    ("mav0/cam1/data", (752, 480), "mav0/cam1/sensor.yaml", EUROC, ["mav0/cam1"], "", 458.654),
    ("mav0/cam0/data", (512, 512), "dso/camchain.yaml", KALIBR, ["", "+"], "cam0", 190.978477),
    ("mav0/cam1/data", (752, 480), "dso/camchain.yaml", KALIBR, ["+"], "cam1", 457.587),
    ("cam1", (752, 480), "camchain-run.yaml", KALIBR, ["+"], "cam1", 457.587),
    ("image_0", (1241, 376), "calib.txt", KITTI, ["+", "+/*.png", f"+/{FIRST}.png"], "P0", 718.856),
    ("image_2", (1241, 376), "calib.txt", KITTI, ["+"], "P2", 719.856),
    ("d_sync/image_02/data", (1242, 375), "calib_cam_to_cam.txt", KITTI_RAW, ["+"], "P_rect_02", 721.5377),
    ("d_extract/image_02/data", (1392, 512), "calib_cam_to_cam.txt", KITTI_RAW, ["+"], "K_02", 959.791),
    ("rgb", (640, 480), "calib.txt", TUM, ["+"], "", 517.306408),
    ("rgb", (640, 480), "calibration_matrix.txt", ICL, ["+"], "", 481.2),
    ("color", (1296, 968), "intrinsic/intrinsic_color.txt", SCANNET, ["+"], "", 1169.621094),
    ("images", (512, 512), "camera.txt", DSO, ["+"], "", 190.978477),
    ("images", (320, 240), "camera_info.yaml", ROS, ["+"], "", 438.783367 / 2),
    ("run", (640, 480), "run/calib.json", JSON, ["+"], "", 500),
]


def images(folder: Path, size: tuple[int, int], count: int = 2) -> Path:
    """Images of one grey, named by stamps 0.1 s apart."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        stamp = FIRST + number * 10**8
        assert cv2.imwrite(str(folder / f"{stamp}.png"), np.full(size[::-1], 90, np.uint8))
    return folder


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


@pytest.mark.parametrize(("place", "size", "name", "text", "inputs", "which", "fx"), LAYOUTS)
def test_layouts(tmp_path, caplog, place, size, name, text, inputs, which, fx):
    images(tmp_path / place, size)
    file = write(tmp_path / name, text)
    for spec in inputs:
        given = tmp_path / spec.replace("+", place)
        source = open_source(given)
        (camera, *_) = cameras = [frame.camera for frame in source]
        assert all(one is camera for one in cameras)
        assert (camera.width, camera.height, camera.fx) == (*size, pytest.approx(fx))
        assert source.calibration == f"{which and which + ' of '}'{file}', fx {fx:.1f} px"
        assert {frame.camera for frame in open_source(given, calibrated=False)} == {None}
    assert not caplog.records


@pytest.mark.parametrize(
    ("place", "name"),
    [
        ("right", "calib.yaml"),  # the other one of two cameras
        ("image_1", "calib.yaml"),
        ("2026-01-01", "calib.yaml"),  # its parent may hold all the recordings that there are
        ("images", "cam.yaml"),
        ("images", "deeper/calib.yaml"),
        ("a/b/images", "calib.yaml"),
    ],
)
def test_what_may_belong_to_others_is_left(tmp_path: Path, place: str, name: str) -> None:
    images(tmp_path / place, (752, 480))
    write(tmp_path / name, EUROC)
    source = open_source(tmp_path / place)
    assert {frame.camera for frame in source} == {None}
    assert source.calibration is None


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("camera.txt", FOV, "'FOV' is not supported"),
        ("calib.txt", "no numbers", "is no camera calibration"),
        ("calib.txt", TUM.replace("318", "918"), "not in the middle half"),
        ("calib.yaml", EUROC, "for images of 752x480 px"),
        ("calib.yaml", "\0", "not valid YAML"),
    ],
)
def test_one_that_makes_no_sense_costs_a_warning(tmp_path, caplog, name, text, said):
    folder = images(tmp_path / "images", (640, 480), count=3)
    file = write(tmp_path / name, text)
    source = open_source(folder)
    assert [frame.camera for frame in source] == [None] * 3
    assert source.calibration is None
    (record,) = caplog.records
    assert record.getMessage().startswith("going on without ")
    assert said in record.getMessage()
    assert str(file) in record.getMessage()
    refused = command(folder, "--headless", "--out", tmp_path / "t.parquet", "--calib", file)
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert said in refused.err
    assert not (tmp_path / "t.parquet").exists()


def test_images_of_another_size_on_the_way(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = images(tmp_path, (752, 480))
    write(folder / "calib.yaml", EUROC)
    cv2.imwrite(str(folder / f"{FIRST + 10**9}.png"), np.zeros((240, 376), np.uint8))
    for seconds, width in ((2, 480), (3, 752), (4, 240)):
        cv2.imwrite(str(folder / f"{FIRST + seconds * 10**9}.png"), np.zeros((480, width), np.uint8))
    source = open_source(folder)
    found = [frame.camera and (frame.camera.width, round(frame.camera.fx, 3)) for frame in source]
    assert found == [(752, 458.654)] * 2 + [(376, 229.327), None, (752, 458.654), None]
    assert source.calibration is not None
    (record,) = caplog.records
    assert f"at '{FIRST + 2 * 10**9}.png' and the like: the calibration is for" in record.getMessage()


def test_an_odd_image_first_does_not_cost_the_others_their_camera(tmp_path: Path) -> None:
    folder = images(tmp_path / "image_0", (1226, 370))
    cv2.imwrite(str(folder / f"{FIRST}.png"), np.zeros((370, 600), np.uint8))
    write(tmp_path / "calib.txt", KITTI)
    source = open_source(folder)
    assert [frame.camera and frame.camera.width for frame in source] == [None, 1226]
    assert source.calibration is not None


def test_rectified_images_take_the_projection_matrix(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = images(tmp_path / "image_rect", (640, 480))
    file = write(folder / "ost.yaml", ROS)
    source = open_source(folder)
    for camera in [frame.camera for frame in source] + [read_calibration(file, folder).camera]:
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (393.6538, 393.6538, 322.797939, 241.090902)
        assert (camera.width, camera.height, camera.distortion) == (640, 480, "none")
    assert source.calibration == f"projection_matrix of '{file}', fx 393.7 px"
    assert not caplog.records
    for text in (ROS.partition("projection_matrix")[0], EUROC):  # their lens is that of the raw images
        write(file, text)
        assert {frame.camera for frame in open_source(folder)} == {None}
    assert [record.getMessage().count("images are rectified") for record in caplog.records] == [1, 1]


def test_a_run_says_what_it_takes(tmp_path: Path) -> None:
    folder = images(tmp_path / "image_2", (1241, 376))
    file = write(tmp_path / "calib.txt", KITTI)
    elsewhere = write(tmp_path / "other" / "kitti.txt", KITTI)
    out, summary = tmp_path / "t.parquet", tmp_path / "run.json"
    for flags, which, said in (
        ([], file, "; --calib none leaves it out"),
        (["--calib", elsewhere], elsewhere, ""),
        (["--calib", "none"], None, ""),
        (["--undistort"], file, "; --calib none leaves it out"),
    ):
        done = command(folder, "--headless", "--out", out, "--overwrite", "--summary", summary, *flags)
        assert done.code == 0, done.err
        text = which and f"P2 of '{which}', fx 719.9 px"
        lines = [line for line in done.out.splitlines() if line.startswith("calibration")]
        none = "none, so lines are in pixels alone: --calib FILE gives one"
        assert lines == [f"calibration: {text}{said}" if which else f"calibration: {none}"]
        assert json.loads(summary.read_text())["calibration"] == text
        assert [tracks.camera and tracks.camera.fx for tracks in read_tracks(out)] == [which and 719.856] * 2
    refused = command(folder, "--headless", "--out", out, "--overwrite", "--calib", "none", "--undistort")
    assert (refused.code, "no camera calibration to undistort with" in refused.err) == (2, True)


def test_the_library_takes_it_too(tmp_path: Path) -> None:
    images(tmp_path / "mav0" / "cam0" / "data", (752, 480))
    write(tmp_path / "mav0" / "cam0" / "sensor.yaml", EUROC)
    for tracks in LineFrontend().stream(tmp_path):
        assert tracks.camera is not None
        assert tracks.observed_normalized is not None


def test_a_batch_takes_it_and_sees_when_it_changes(tmp_path: Path) -> None:
    folder, out = images(tmp_path / "image_0", (1241, 376)), tmp_path / "out"
    file = write(tmp_path / "calib.txt", KITTI)

    def run() -> tuple[str, float | None]:
        (row,) = run_batch([folder], out)
        tracks = next(iter(read_tracks(out / "image_0" / "tracks.parquet")))
        return row.status, tracks.camera and tracks.camera.fx

    assert run() == ("done", 718.856)
    assert run() == ("skipped", 718.856)
    write(file, KITTI.replace("7.188560000000e+02", "7.000000000000e+02"))
    assert run() == ("done", 700)


@pytest.mark.parametrize(
    ("place", "name", "text", "given"),
    [
        ("mav0/cam0/data", "mav0/cam0/sensor.yaml", EUROC, "mav0"),
        ("run/mav0/cam0/data", "run/dso/camchain.yaml", KALIBR, "run"),
        ("image_0", "calib.txt", KITTI, f"image_0/{FIRST}.png"),
        ("image_0", "calib.txt", KITTI, "image_0"),
    ],
)
def test_a_batch_knows_each_calibration_that_the_source_takes(tmp_path, place, name, text, given):
    images(tmp_path / place, (512, 512))
    file = write(tmp_path / name, text)
    for config, files in ((RunConfig(), {str(file)}), (RunConfig(input=InputConfig(calib="none")), set())):
        _, (job,) = make_plan([tmp_path / given], tmp_path, job_settings(config, ["parquet"]), overwrite=False)
        assert job.made_from["files"].keys() == files


def test_planning_loads_no_opencv(tmp_path: Path) -> None:
    images(tmp_path / "image_0", (64, 48))
    code = f"""
import sys
from pathlib import Path
from frontend.batch.plan import _beside
from frontend.cli.settings import InputConfig
print(*_beside(Path({str(tmp_path / "image_0")!r}), InputConfig()), "cv2" in sys.modules)
"""
    file = write(tmp_path / "calib.txt", KITTI)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == f"{file} False\n"


def test_times_as_dso_has_them(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(2):
        cv2.imwrite(str(folder / f"{number:05}.png"), np.zeros((24, 32), np.uint8))
    write(tmp_path / "times.txt", "00000 1443624512.25 0.5\n00001 1443624512.5 1.25\n")
    assert [frame.stamp_ns for frame in open_source(folder)] == [1443624512250000000, 1443624512500000000]

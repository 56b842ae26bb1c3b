"""Calibration files of tools and data sets, as these write them, where they lie, and everything that can be wrong."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from airline.errors import ConfigError, InputError
from frontend.camera.calibration import Calibration, fit_camera, read_calibration
from frontend.camera.model import CameraModel

EUROC = """\
# General sensor definitions.
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)
T_BS:
  cols: 4
  rows: 4
  data: [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,
         0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,
        -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
"""

KALIBR = """\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202, 0.00020293673591811182]
  distortion_model: equidistant
  intrinsics: [190.97847715128717, 190.9733070521226, 254.93170605935475, 256.8974428996504]
  resolution: [512, 512]
  rostopic: /cam0/image_raw
cam1:
  camera_model: pinhole
  distortion_coeffs: [-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05]
  distortion_model: radtan
  intrinsics: [457.587, 456.134, 379.999, 255.238]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
cam2:
  camera_model: pinhole
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [400.0, 401.0, 319.5, 239.5]
  resolution: [640, 480]
"""

ROS = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.000000, 0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653800, 0, 322.797939, 0.000000, 0.000000, 393.653800, 241.090902, 0, 0.000000, 0.000000, 1.000000, 0]
"""

OPENCV = """\
%YAML:1.0
---
calibration_time: "Mon 02 Mar 2020 10:11:12"
image_width: 1280
image_height: 720
flags: 16384
fisheye_model: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 9.0e+02, 0., 6.4e+02, 0., 9.0e+02, 3.6e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 8
   cols: 1
   dt: d
   data: [ 11.7, 6.2, 4.0e-04, -3.0e-04, 0.3, 12.1, 9.8, 1.9 ]
"""

JSON = """\
{"width": 640, "height": 480, "fx": 500, "fy": 501.5, "cx": 319.5, "cy": 2.395e2,
 "distortion": "equidistant", "coefficients": [0.1, -0.02, 0.003, 0]}
"""

KITTI = """\
P0: 7.188560000000e+02 0.000000000000e+00 6.071928000000e+02 0.000000000000e+00 0.000000000000e+00 7.188560000000e+02 \
1.852157000000e+02 0.000000000000e+00 0.000000000000e+00 0.000000000000e+00 1.000000000000e+00 0.000000000000e+00
P1: 7.188560000000e+02 0.000000000000e+00 6.071928000000e+02 -3.861448000000e+02 0.000000000000e+00 7.188560000000e+02 \
1.852157000000e+02 0.000000000000e+00 0.000000000000e+00 0.000000000000e+00 1.000000000000e+00 0.000000000000e+00
P2: 7.198560000000e+02 0.000000000000e+00 6.071928000000e+02 4.538225000000e+01 0.000000000000e+00 7.188560000000e+02 \
1.852157000000e+02 -1.130887000000e-01 0.000000000000e+00 0.000000000000e+00 1.000000000000e+00 3.779761000000e-03
Tr: 4.27e-04 -9.99e-01 -8.08e-03 -1.19e-02 -7.21e-03 8.08e-03 -9.99e-01 -5.40e-02 9.99e-01 4.85e-04 -7.20e-03 -2.92e-01
"""

KITTI_RAW = """\
calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_02: 1.392000e+03 5.120000e+02
K_02: 9.597910e+02 0.000000e+00 6.960217e+02 0.000000e+00 9.569251e+02 2.241806e+02 0.000000e+00 0.000000e+00 1.0
D_02: -3.691481e-01 1.968681e-01 1.353473e-03 5.677587e-04 -6.770705e-02
S_rect_02: 1.242000e+03 3.750000e+02
P_rect_02: 7.215377e+02 0.000000e+00 6.095593e+02 4.485728e+01 0.000000e+00 7.215377e+02 1.728540e+02 2.163791e-01 \
0.000000e+00 0.000000e+00 1.000000e+00 2.745884e-03
"""

ICL = "481.20\t0\t319.50\n0\t-480.00\t239.50\n0\t0\t1\n"

SCANNET = """\
1169.621094 0.000000 646.295044 0.000000
0.000000 1167.105103 489.927032 0.000000
0.000000 0.000000 1.000000 0.000000
0.000000 0.000000 0.000000 1.000000
"""

TUM = "# fr1\n517.306408 516.469215 318.643040 255.313989 0.262383 -0.953104 -0.005358 0.002628 1.163314\n"

DSO = """\
EquiDistant 0.373004838186 0.372994740336 0.498890050897 0.502729380663 0.00348238940225 0.000715034845216 \
-0.00205323614187 0.000202936735918
512 512
crop
512 512
"""

PLANE = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.4, 0.4, 7)), axis=-1).reshape(-1, 2)


def save(folder: Path, text: str, name: str = "calib.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def opencv(camera: CameraModel, model: str, k: list[float], d: list[float]) -> None:
    """OpenCV projects with the numbers of the file where the camera projects."""
    fx, fy, cx, cy = k
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    rays, zero = np.column_stack([PLANE, np.ones(len(PLANE))]).reshape(-1, 1, 3), np.zeros(3)
    project = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    pixels = project(rays, zero, zero, matrix, np.array(d))[0].reshape(-1, 2)
    np.testing.assert_allclose(camera.project(PLANE), pixels, atol=1e-3)


def test_euroc(tmp_path: Path) -> None:
    d = [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
    for text in (EUROC, "%YAML:1.0\n" + EUROC, "%YAML:1.0\n---\n" + EUROC, "\ufeff" + EUROC, EUROC + "---\na: b\n"):
        camera = read_calibration(save(tmp_path, text)).camera
        assert (camera.width, camera.height, camera.distortion) == (752, 480, "radial-tangential")
        opencv(camera, "", [458.654, 457.296, 367.215, 248.375], d)


def test_kalibr(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = save(tmp_path, KALIBR)
    with caplog.at_level(logging.WARNING):
        fisheye = read_calibration(path).camera
    assert "cam0, cam1, cam2: using cam0" in caplog.text
    assert (fisheye.width, fisheye.height, fisheye.distortion) == (512, 512, "equidistant")
    k = [190.97847715128717, 190.9733070521226, 254.93170605935475, 256.8974428996504]
    opencv(fisheye, "fisheye", k, [0.00348238940225, 0.000715034845216, -0.00205323614187, 0.000202936735918])
    caplog.clear()
    _, second, third = re.split(r"^(?=cam)", KALIBR, flags=re.MULTILINE)[1:]
    radtan = read_calibration(save(tmp_path, second)).camera
    assert (radtan.width, radtan.height, radtan.distortion) == (752, 480, "radial-tangential")
    opencv(radtan, "", [457.587, 456.134, 379.999, 255.238], [-0.28368365, 0.07451284, -0.00010473, -3.5559e-05])
    assert read_calibration(save(tmp_path, third)).camera.distortion == "none"
    assert not caplog.records


def test_ros_and_opencv(tmp_path: Path) -> None:
    path = save(tmp_path, ROS)
    camera = read_calibration(path).camera
    assert (camera.width, camera.height) == (640, 480)
    k, d = [438.783367, 437.302876, 305.593336, 243.738352], [-0.361976, 0.11051, 0.001014, 0.000505]
    opencv(camera, "", k, d)
    fisheye = ROS.replace("plumb_bob", "fisheye").replace("0.000505, 0.000000]", "0.000505]")
    opencv(read_calibration(save(tmp_path, fisheye)).camera, "fisheye", k, d)
    ideal = ROS.replace("-0.361976, 0.110510, 0.001014, 0.000505, 0.000000", "0, 0, 0, 0, 0")
    assert read_calibration(save(tmp_path, ideal)).camera.distortion == "none"
    rational = read_calibration(save(tmp_path, OPENCV, "out.yml")).camera
    assert (rational.width, rational.height) == (1280, 720)
    opencv(rational, "", [900, 900, 640, 360], [11.7, 6.2, 4e-4, -3e-4, 0.3, 12.1, 9.8, 1.9])


def kitti(folder: Path, text: str, name: str, images: str) -> Calibration:
    return read_calibration(save(folder, text, name), folder / images)


def test_kitti(tmp_path: Path) -> None:
    for images, which, fx in (("image_0", "P0", 718.856), ("image_2", "P2", 719.856), ("left/*.png", "P0", 718.856)):
        found = kitti(tmp_path, KITTI, "calib.txt", images)
        assert found.which == which
        opencv(found.camera, "", [fx, 718.856, 607.1928, 185.2157], [0.0] * 4)
        assert str(found) == f"{which} of '{tmp_path / 'calib.txt'}', fx {fx:.1f} px"
    assert fit_camera(found.camera, 1241, 376).width == 1241
    with pytest.raises(InputError, match="P3 must be 12 numbers"):
        kitti(tmp_path, KITTI, "calib.txt", "image_3")
    nameless = kitti(tmp_path, KITTI.replace("P0: ", "").replace("P1: ", ""), "calib.txt", "images")
    assert (nameless.which, nameless.camera.fx) == ("row 1", 718.856)


def test_kittis_raw_data(tmp_path: Path) -> None:
    sync, extract = (f"2011_09_26_drive_0001_{kind}/image_02/data" for kind in ("sync", "extract"))
    rectified = kitti(tmp_path, KITTI_RAW, "calib_cam_to_cam.txt", sync)
    assert (rectified.which, rectified.camera.width, rectified.camera.height) == ("P_rect_02", 1242, 375)
    opencv(rectified.camera, "", [721.5377, 721.5377, 609.5593, 172.854], [0.0] * 4)
    raw = kitti(tmp_path, KITTI_RAW, "calib_cam_to_cam.txt", extract)
    assert (raw.which, raw.camera.width, raw.camera.height) == ("K_02", 1392, 512)
    d = [-0.3691481, 0.1968681, 1.353473e-03, 5.677587e-04, -0.06770705]
    opencv(raw.camera, "", [959.791, 956.9251, 696.0217, 224.1806], d)
    with pytest.raises(InputError, match="row S_rect_00 must be 2 numbers"):
        kitti(tmp_path, KITTI_RAW, "calib_cam_to_cam.txt", "images")


def test_matrices(tmp_path: Path) -> None:
    icl = read_calibration(save(tmp_path, ICL, "calibration_matrix.txt"))
    assert icl.y_up
    opencv(icl.camera, "", [481.2, 480.0, 319.5, 239.5], [0.0] * 4)
    scannet = read_calibration(save(tmp_path, SCANNET, "intrinsic_color.txt"))
    assert not scannet.y_up
    opencv(scannet.camera, "", [1169.621094, 1167.105103, 646.295044, 489.927032], [0.0] * 4)
    assert (fit_camera(scannet.camera, 1296, 968).width, fit_camera(icl.camera, 640, 480).height) == (1296, 480)
    for size in ((640, 480), (2592, 1936), (1296, 400)):  # resized or cropped since
        with pytest.raises(InputError, match="not in the middle half"):
            fit_camera(scannet.camera, *size)


def test_tum(tmp_path: Path) -> None:
    k, d = [517.306408, 516.469215, 318.643040, 255.313989], [0.262383, -0.953104, -0.005358, 0.002628, 1.163314]
    opencv(read_calibration(save(tmp_path, TUM, "calib.txt")).camera, "", k, d)
    four = " ".join(map(str, k))
    assert read_calibration(save(tmp_path, four, "calib.txt")).camera.distortion == "none"
    eight = read_calibration(save(tmp_path, f"{four} 0.26 -0.95 -0.005 0.002", "calib.txt")).camera
    opencv(eight, "", k, [0.26, -0.95, -0.005, 0.002])


def test_dso(tmp_path: Path) -> None:
    """The data set gives one camera in DSO's and in Kalibr's form."""
    ours = read_calibration(save(tmp_path, DSO, "camera.txt")).camera
    kalibr = read_calibration(save(tmp_path, KALIBR), "cam0/data").camera
    assert (ours.width, ours.height, ours.distortion) == (512, 512, "equidistant")
    np.testing.assert_allclose(ours.project(PLANE), kalibr.project(PLANE), atol=1e-3)
    pinhole = "Pinhole 400 401 319.5 239.5 0\n640 480\nnone\n640 480\n"
    camera = read_calibration(save(tmp_path, pinhole, "camera.txt")).camera
    assert (camera.width, camera.cx, camera.distortion) == (640, 319.5, "none")
    assert read_calibration(save(tmp_path, pinhole[8:], "camera.txt")).camera.fy == 401
    radtan = "400 401 319.5 239.5 -0.28 0.07 0.0002 0.00002\n640 480\ncrop\n640 480\n"
    opencv(read_calibration(save(tmp_path, radtan)).camera, "", [400, 401, 319.5, 239.5], [-0.28, 0.07, 2e-4, 2e-5])


def test_json(tmp_path: Path) -> None:
    camera = read_calibration(save(tmp_path, JSON, "calib.json")).camera
    assert (camera.width, camera.height, camera.distortion) == (640, 480, "equidistant")
    opencv(camera, "fisheye", [500, 501.5, 319.5, 239.5], [0.1, -0.02, 0.003, 0])
    plain = {"width": 64, "height": 48, "fx": 50, "fy": 50, "cx": 31.5, "cy": 23.5}
    assert read_calibration(save(tmp_path, json.dumps(plain))).camera.distortion == "none"


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (EUROC, "intrinsics: [458.654, ", "intrinsics: [", "intrinsics: expected `array` of length >= 4"),
        (EUROC, "458.654", "wide", r"intrinsics\[0\]: expected `float`, got `str`"),
        (EUROC, "458.654", ".nan", r"intrinsics\[0\]: expected `float` >= -1000000000"),
        (EUROC, "458.654", "-458.654", "focal lengths must be positive"),
        (EUROC, "458.654", "1" * 5000, "not valid YAML: .* 5000 digits"),
        (EUROC, "[752, 480]", "[752.5, 480]", r"resolution\[0\]: expected `int`"),
        (EUROC, "resolution:", "size:", "missing required field `resolution`"),
        (EUROC, "0.07395907, ", "", "takes 4 or 5 or 8 coefficients, not 3"),
        (EUROC, "distortion_coefficients", "coefficients", "distortion_coefficients is missing"),
        (KALIBR, "camera_model: pinhole", "camera_model: omni", "camera model 'omni' is not supported"),
        (KALIBR, "equidistant", "fov", "distortion model 'fov' is not supported"),
        (ROS, "438.783367, 0.000000", "438.783367, 0.5", "camera matrix must be of the form"),
        (ROS, "image_width: 640\n", "", "missing required field `image_width`"),
        (JSON, '"fx": 500', '"fx": true', "fx: expected `float`"),
        (JSON, '"fx": 500', '"fx": NaN', "fx: expected `float`"),
        (JSON, '"fy": 501.5', '"focal": 501.5', "contains unknown field `focal`"),
        (JSON, "640,", "640", "not valid JSON"),
        (EUROC, "rate_hz: 20", "rate_hz: &a 20", "has the YAML anchor 'a'"),
        (EUROC, "rate_hz: 20", "rate_hz: 20\nrate_hz: 30", r"in line \d+: found duplicate key .rate_hz."),
        (EUROC, "[752, 480]", "[752, 480", "not valid YAML in line"),
        (EUROC, "20", "[" * 40 + "]" * 40, "nested deeper"),
        (EUROC, EUROC, "", "is no camera calibration"),
        (KITTI, "0.000000000000e+00\nP1", "\nP1", "rows of 11, 12, 12, 12 numbers"),
        (KITTI, "6.071928000000e+02", "nan", "not finite"),
        (KITTI, "6.071928000000e+02", "6e300", "not finite, or beyond"),
        (KITTI, "0.000000000000e+00", "0.5", "must be of the form"),
        (KITTI_RAW, "S_rect_02", "S_rect_00", "row P_rect_00 must be 12 numbers"),
        (KITTI_RAW, "S_02", "S_00", "row S_rect_00"),
        (ICL, "481.20", "-481.20", "focal lengths must be positive"),
        (ICL, "319.50", "", "rows of 2, 3, 3 numbers"),
        (SCANNET, "646.295044", "wide", "is no camera calibration"),
        (TUM, " 1.163314", " 1 2 3", "rows of 11 numbers"),
        (DSO, "EquiDistant", "FOV", "'FOV' is not supported"),
        (DSO, "EquiDistant", "Mei", "'Mei' is not supported"),
        (DSO, "512 512\ncrop", "512.5 512\ncrop", "whole numbers from 1 to 65536"),
        (DSO, "512 512\ncrop", "512 99999\ncrop", "whole numbers from 1 to 65536"),
        (EUROC, "20", "x" * 300_000, "longer than the 256 KB"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, text: str, old: str, new: str, message: str) -> None:
    assert old in text
    path = save(tmp_path, text.replace(old, new, 1))
    with pytest.raises((InputError, ConfigError), match=message) as caught:
        read_calibration(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    for name in ("missing.yaml", ".", "nul\0", "picture.png"):
        with pytest.raises(InputError, match="not a text file" if name == "picture.png" else "cannot read"):
            read_calibration(tmp_path / name)


def test_a_camera_for_other_sizes(tmp_path: Path) -> None:
    camera = read_calibration(save(tmp_path, EUROC)).camera
    assert fit_camera(camera, 752, 480) is camera
    half = fit_camera(camera, 376, 240)
    assert (half.width, half.height, half.fx) == (376, 240, camera.fx / 2)
    assert half.cx == pytest.approx((camera.cx + 0.5) / 2 - 0.5)
    assert fit_camera(camera, 501, 320).height == 320  # 501.33
    with pytest.raises(InputError, match="752x480 px, these have 640x480"):
        fit_camera(camera, 640, 480)
    with pytest.raises(InputError, match="480x752"):
        fit_camera(camera, 480, 752)

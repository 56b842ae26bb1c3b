"""Calibration files: EuRoC, Kalibr, ROS and JSON, as their tools write them, and everything that can be wrong."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from airline.errors import ConfigError, InputError
from frontend.camera.calibration import fit_camera, read_calibration
from frontend.camera.model import CameraModel

EUROC = """\
# General sensor definitions.
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)
T_BS:
  cols: 4
  rows: 1
  data: [0.0148655429818, -0.999880929698,
         0.00414029679422, -0.0216401454975]
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
        camera = read_calibration(save(tmp_path, text))
        assert (camera.width, camera.height, camera.distortion) == (752, 480, "radial-tangential")
        opencv(camera, "", [458.654, 457.296, 367.215, 248.375], d)


def test_kalibr(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = save(tmp_path, KALIBR)
    with caplog.at_level(logging.WARNING):
        fisheye = read_calibration(path)
    assert "cam0, cam1, cam2: using cam0" in caplog.text
    assert (fisheye.width, fisheye.height, fisheye.distortion) == (512, 512, "equidistant")
    k = [190.97847715128717, 190.9733070521226, 254.93170605935475, 256.8974428996504]
    opencv(fisheye, "fisheye", k, [0.00348238940225, 0.000715034845216, -0.00205323614187, 0.000202936735918])
    caplog.clear()
    _, second, third = re.split(r"^(?=cam)", KALIBR, flags=re.MULTILINE)[1:]
    radtan = read_calibration(save(tmp_path, second))
    assert (radtan.width, radtan.height, radtan.distortion) == (752, 480, "radial-tangential")
    opencv(radtan, "", [457.587, 456.134, 379.999, 255.238], [-0.28368365, 0.07451284, -0.00010473, -3.5559e-05])
    assert read_calibration(save(tmp_path, third)).distortion == "none"
    assert not caplog.records


def test_ros_and_opencv(tmp_path: Path) -> None:
    path = save(tmp_path, ROS)
    camera = read_calibration(path)
    assert (camera.width, camera.height) == (640, 480)
    k, d = [438.783367, 437.302876, 305.593336, 243.738352], [-0.361976, 0.11051, 0.001014, 0.000505]
    opencv(camera, "", k, d)
    fisheye = ROS.replace("plumb_bob", "fisheye").replace("0.000505, 0.000000]", "0.000505]")
    opencv(read_calibration(save(tmp_path, fisheye)), "fisheye", k, d)
    ideal = ROS.replace("-0.361976, 0.110510, 0.001014, 0.000505, 0.000000", "0, 0, 0, 0, 0")
    assert read_calibration(save(tmp_path, ideal)).distortion == "none"
    rational = read_calibration(save(tmp_path, OPENCV, "out.yml"))
    assert (rational.width, rational.height) == (1280, 720)
    opencv(rational, "", [900, 900, 640, 360], [11.7, 6.2, 4e-4, -3e-4, 0.3, 12.1, 9.8, 1.9])


def test_json(tmp_path: Path) -> None:
    camera = read_calibration(save(tmp_path, JSON, "calib.json"))
    assert (camera.width, camera.height, camera.distortion) == (640, 480, "equidistant")
    opencv(camera, "fisheye", [500, 501.5, 319.5, 239.5], [0.1, -0.02, 0.003, 0])
    plain = {"width": 64, "height": 48, "fx": 50, "fy": 50, "cx": 31.5, "cy": 23.5}
    assert read_calibration(save(tmp_path, json.dumps(plain))).distortion == "none"


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
        (ROS, "438.783367, 0.000000", "438.783367, 0.5", "camera_matrix must be of the form"),
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
    camera = read_calibration(save(tmp_path, EUROC))
    assert fit_camera(camera, 752, 480) is camera
    half = fit_camera(camera, 376, 240)
    assert (half.width, half.height, half.fx) == (376, 240, camera.fx / 2)
    assert half.cx == pytest.approx((camera.cx + 0.5) / 2 - 0.5)
    assert fit_camera(camera, 501, 320).height == 320  # 501.33
    with pytest.raises(InputError, match="752x480 px, these have 640x480"):
        fit_camera(camera, 640, 480)
    with pytest.raises(InputError, match="480x752"):
        fit_camera(camera, 480, 752)

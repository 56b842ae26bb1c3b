"""Cameras out of calibration messages, by hand-computed cases, and the pairing of topics."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from airline.errors import InputError
from frontend.camera.calibration import is_rectified
from logs.calibration import camera_of, info_topic_for
from logs.messages.types import CameraInfo

K = (500.0, 0.0, 321.5, 0.0, 510.0, 241.5, 0.0, 0.0, 1.0)
P = (450.0, 0.0, 318.0, -54.0, 0.0, 450.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0)
EYE = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
D5 = (-0.3, 0.1, 0.001, -0.002, 0.01)
D8 = (11.7, 6.2, 0.0004, -0.0003, 0.3, 12.1, 9.8, 1.9)
D4 = (0.12, -0.05, 0.02, -0.004)


def info(**changes: object) -> CameraInfo:
    values: dict[str, object] = {"stamp_ns": 0, "frame_id": "cam", "width": 640, "height": 480}
    values |= {"distortion_model": "plumb_bob", "d": D5, "k": K, "r": EYE, "p": P}
    return CameraInfo(**(values | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("model", "d", "kind"),
    [
        ("plumb_bob", D5, "radial-tangential"),
        ("rational_polynomial", D8, "radial-tangential"),
        ("rational_polynomial", (*D8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), "radial-tangential"),
        ("equidistant", D4, "equidistant"),
        ("kannala_brandt", D4, "equidistant"),
        ("Kannala-Brandt", (0.0, 0.0, 0.0, 0.0), "equidistant"),
        ("plumb_bob", (0.0,) * 5, "none"),
        ("plumb_bob", (), "none"),
        ("", (), "none"),
        ("none", (), "none"),
    ],
)
def test_models_project_as_opencv_does(model: str, d: tuple[float, ...], kind: str) -> None:
    camera = camera_of(info(distortion_model=model, d=d), (640, 480), rectified=False)
    assert camera.distortion == kind
    plane = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.4, 0.4, 7)), axis=-1).reshape(-1, 2)
    rays, zero = np.column_stack([plane, np.ones(len(plane))]).reshape(-1, 1, 3), np.zeros(3)
    project = cv2.fisheye.projectPoints if kind == "equidistant" else cv2.projectPoints
    pixels = project(rays, zero, zero, np.reshape(K, (3, 3)), np.array(d or (0.0,) * 4))[0].reshape(-1, 2)
    np.testing.assert_allclose(camera.project(plane), pixels, atol=1e-3)


def test_region_of_interest_and_binning() -> None:
    cropped = camera_of(info(roi=(100, 40, 400, 300)), (400, 300), rectified=False)
    assert (cropped.fx, cropped.fy, cropped.cx, cropped.cy) == (500, 510, 221.5, 201.5)
    binned = camera_of(info(binning=(2, 2)), (320, 240), rectified=False)
    # the first binned pixel merges the pixels 0 and 1, whose middle is 0.5
    assert (binned.fx, binned.fy, binned.cx, binned.cy) == (250, 255, (321.5 - 0.5) / 2, (241.5 - 0.5) / 2)
    both = camera_of(info(roi=(100, 40, 402, 301), binning=(4, 2)), (100, 150), rectified=False)
    assert (both.fx, both.fy, both.cx, both.cy) == (125, 255, (221.5 - 1.5) / 4, (201.5 - 0.5) / 2)
    zeros = camera_of(info(roi=(0, 0, 0, 0), binning=(0, 0)), (640, 480), rectified=False)
    assert (zeros.fx, zeros.cx) == (500, 321.5)
    rectified = camera_of(info(roi=(100, 40, 400, 300), binning=(2, 2)), (200, 150), rectified=True)
    assert (rectified.fx, rectified.cx, rectified.cy) == (225, (218 - 0.5) / 2, (200 - 0.5) / 2)


def test_a_binned_point_is_where_its_pixels_were() -> None:
    full = camera_of(info(), (640, 480), rectified=False)
    binned = camera_of(info(binning=(2, 2)), (320, 240), rectified=False)
    np.testing.assert_allclose(binned.normalize(np.array([100.0, 70.0])), full.normalize(np.array([200.5, 140.5])))


def test_rectified_images() -> None:
    camera = camera_of(info(), (640, 480), rectified=True)
    assert (camera.distortion, camera.fx, camera.fy, camera.cx, camera.cy) == ("none", 450, 450, 318, 240)
    ideal = camera_of(info(p=(), d=()), (640, 480), rectified=True)
    assert (ideal.distortion, ideal.fx, ideal.cx) == ("none", 500, 321.5)
    with pytest.raises(InputError, match="uncalibrated"):
        camera_of(info(p=(0.0,) * 12), (640, 480), rectified=True)


def test_other_sizes() -> None:
    half = camera_of(info(), (320, 240), rectified=False)
    assert (half.width, half.height, half.fx, half.cx) == (320, 240, 250, (321.5 + 0.5) / 2 - 0.5)
    assert camera_of(info(width=0, height=0), (640, 480), rectified=False).fx == 500
    # some drivers give the size of the binned image as the full one
    assert camera_of(info(binning=(2, 2)), (640, 480), rectified=False).fx == 500
    with pytest.raises(InputError, match="640x480 px, these have 640x360"):
        camera_of(info(), (640, 360), rectified=False)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"k": (0.0,) * 9}, "uncalibrated"),
        ({"k": K[:8]}, "8 numbers where K has 9"),
        ({"k": (float("nan"), *K[1:])}, "make no sense"),
        ({"k": (500.0, 0.7, *K[2:])}, "skew"),
        ({"distortion_model": "fov", "d": (0.9,)}, "'fov' is not supported"),
        ({"distortion_model": "", "d": D5}, "no coefficients other than zeros"),
        ({"d": (0.1, 0.2, 0.3)}, "takes 4 or 5 or 8"),
        ({"distortion_model": "equidistant", "d": D8}, "takes 4 coefficients, not 8"),
        ({"distortion_model": "rational_polynomial", "d": (*D8, 0.1, 0.0, 0.0, 0.0)}, "not 12"),
        ({"roi": (600, 0, 100, 480)}, "outside of the sensor"),
        ({"binning": (1000, 1)}, "leaves no pixel"),
        ({"width": 2**32 - 1}, "makes no sense"),
        ({"height": -480}, "makes no sense"),
    ],
)
def test_nonsense_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        camera_of(info(**changes), (640, 480), rectified=False)


@pytest.mark.parametrize(
    ("image", "calibrations", "expected"),
    [
        ("/cam/image_raw", ["/cam/camera_info", "/other/camera_info"], "/cam/camera_info"),
        ("/cam/image_raw/compressed", ["/cam/camera_info", "/other/camera_info"], "/cam/camera_info"),
        ("/camera/color/image_raw", ["/camera/depth/camera_info", "/camera/color/camera_info"],
         "/camera/color/camera_info"),
        ("/camera/color/image_raw", ["/camera/depth/camera_info"], None),
        ("/camera/left/image_raw", ["/camera/camera_info", "/lidar/camera_info"], "/camera/camera_info"),
        ("/left/image_rect", ["/left/camera_info", "/left/camera_info_rect"], "/left/camera_info_rect"),
        ("/left/image_raw", ["/left/camera_info", "/left/camera_info_rect"], "/left/camera_info"),
        ("/robot/left_image", ["/robot/left_camera_info", "/robot/right_camera_info"], "/robot/left_camera_info"),
        ("/robot/left/image", ["/robot/left_camera_info", "/robot/right_camera_info"], "/robot/left_camera_info"),
        ("/robot/image", ["/robot/left_camera_info", "/robot/right_camera_info"], None),
        ("/rgb/image", ["/rgb/image/camera_info", "/rgb/camera_info"], "/rgb/image/camera_info"),
        ("/CAM_FRONT/image_rect_compressed", ["/CAM_FRONT/camera_info", "/CAM_BACK/camera_info"],
         "/CAM_FRONT/camera_info"),
        ("/image_raw", ["/camera_info", "/left/camera_info"], "/camera_info"),
        ("/right/image_raw", ["/camera_info", "/left/camera_info"], None),
        ("/image_raw", ["/usb_cam/camera_info"], "/usb_cam/camera_info"),
        ("/cam/image_raw", ["/camera_info"], "/camera_info"),
        ("/cam/image_raw", ["/cam/info/camera_info"], "/cam/info/camera_info"),
        ("/front/image", ["/fr/camera_info"], None),
        ("image", ["camera_info"], "camera_info"),
        ("", ["/", "/a", "/b"], None),
    ],
)  # fmt: skip
def test_which_calibration_belongs_to_an_image_topic(image: str, calibrations: list[str], expected: str | None) -> None:
    assert info_topic_for(image, calibrations) == expected
    assert info_topic_for(image, calibrations[::-1]) == expected


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [
        ("/left/image_rect", True),
        ("/left/image_rect_color/compressed", True),
        ("/zed/rgb/rect/image", True),
        ("/left/image_raw", False),
        ("/rectangles/image", False),
        ("/zed/rgb/unrectified/image", False),
        ("", False),
    ],
)
def test_rectified_topics(topic: str, rectified: bool) -> None:
    assert is_rectified(topic) == rectified

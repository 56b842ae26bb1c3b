"""Undistortion: straight lines become straight, nothing black appears, and directions stay what they were."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from airline import AirLine
from airline.errors import ConfigError, InputError
from frontend.camera.model import CameraModel, Distortion
from frontend.camera.undistort import WIDEST_DEG, Undistorter, undistorted_camera
from frontend.frame import Frame
from frontend.sources.wrapped import CalibratedFrames, SelectedFrames
from tests.helpers.sources import Listed, Seekable

LENSES: dict[str, tuple[Distortion, list[float]]] = {
    "EuRoC": ("radial-tangential", [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]),
    "pincushion": ("radial-tangential", [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
    "decentred": ("radial-tangential", [-0.3, 0.1, 0.008, -0.006]),
    "rational": ("radial-tangential", [11.7, 6.2, 0.0004, -0.0003, 0.3, 12.1, 9.8, 1.9]),
    "fisheye": ("equidistant", [0.0034823894, 0.00071503485, -0.0020532361, 0.00020293674]),
}


def camera(lens: str, width: int = 640, height: int = 480) -> CameraModel:
    kind, coefficients = LENSES[lens]
    focal = (0.35 if kind == "equidistant" else 0.65) * width
    centre = width / 2 - 3.5, height / 2 + 2.25
    return CameraModel(width, height, focal, 1.01 * focal, *centre, kind, np.array(coefficients))


def plane_of(model: CameraModel) -> NDArray[np.float64]:
    """(H, W, 2) normalised coordinates of every pixel."""
    pixels = np.stack(np.meshgrid(np.arange(model.width), np.arange(model.height)), axis=-1)
    return np.nan_to_num(model.normalize(pixels).astype(np.float64), nan=9.0)  # a fisheye's corners see no plane


@pytest.mark.parametrize("lens", ["EuRoC", "decentred", "rational", "fisheye"])
def test_detected_lines_are_straight_where_they_were_bent(lens: str) -> None:
    source = camera(lens)
    inside = 0.3 - np.abs(plane_of(source)).max(axis=-1)  # a square whose sides are at -0.3 and 0.3
    image = (155 - 75 * np.tanh(inside * source.fx)).astype(np.uint8)
    errors = []
    for frame in (Frame(0, 0, image, source), Frame(0, 0, (remap := Undistorter(source))(image), remap.camera)):
        segments = AirLine()(frame.image).segments
        long = segments[np.hypot(*(segments[:, 1] - segments[:, 0]).T) > 25]
        assert len(long) >= 4
        share = np.linspace(0, 1, 21)[:, None]
        points = long[:, None, 0] + share * (long[:, None, 1] - long[:, None, 0])
        off = np.abs(np.abs(frame.camera.normalize(points.astype(np.float64))) - 0.3).max(axis=1).min(axis=-1)
        errors.append(np.median(off) * source.fx)
    bent, straight = errors  # px
    assert bent > 1
    assert straight < 0.1


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("size", [(640, 480), (480, 640), (1280, 400)])
def test_the_new_image_is_covered_and_cannot_be_larger(lens: str, size: tuple[int, int]) -> None:
    source = camera(lens, *size)
    new = undistorted_camera(source)
    assert (new.width, new.height, new.distortion) == (*size, "none")
    assert new.fx / new.fy == pytest.approx(source.fx / source.fy)
    pixels = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), axis=-1)
    seen = source.project(new.normalize(pixels))
    assert seen.min() > -0.05
    assert (seen.reshape(-1, 2).max(axis=0) < np.array(size) - 0.95).all()
    angle = np.rad2deg(np.arctan(np.hypot(*new.normalize(pixels).reshape(-1, 2).T).max()))
    assert angle < WIDEST_DEG + 0.01
    edge = np.array([seen[..., 0].min(), seen[..., 1].min(), *(np.array(size) - 1 - seen.reshape(-1, 2).max(axis=0))])
    assert edge.min() < 0.2 or angle > WIDEST_DEG - 0.2  # it touches one
    white = np.full((size[1], size[0]), 255, np.uint8)
    assert Undistorter(source)(white).min() == 255


@pytest.mark.parametrize("lens", LENSES)
def test_the_remapping_is_opencvs(lens: str) -> None:
    source = camera(lens)
    rng = np.random.default_rng(1)
    image = cv2.GaussianBlur(rng.integers(0, 255, (480, 640, 3), np.uint8), (0, 0), 2)
    remap = Undistorter(source)
    init = cv2.fisheye.initUndistortRectifyMap if source.distortion == "equidistant" else cv2.initUndistortRectifyMap
    maps = init(source.matrix, source.coefficients, np.eye(3), remap.camera.matrix, (640, 480), cv2.CV_32FC1)
    exact = cv2.remap(image, *maps, cv2.INTER_LINEAR)
    difference = np.abs(remap(image).astype(int) - exact)[1:-1, 1:-1]
    assert difference.max() <= 4
    assert difference.mean() < 0.3
    deep = remap(image.astype(np.uint16) * 200)
    assert deep.dtype == np.uint16
    assert np.abs(deep[1:-1, 1:-1] / 200 - exact[1:-1, 1:-1]).max() < 4


def frames(count: int = 4, size: tuple[int, int] = (640, 480), carried: CameraModel | None = None) -> list[Frame]:
    return [Frame(k, k * 10**9, np.full((size[1], size[0]), 99, np.uint8), carried) for k in range(count)]


def test_frames_carry_the_camera() -> None:
    given = camera("EuRoC")
    source = Listed(frames(), skipped=2)
    wrapped = CalibratedFrames(source, given)
    assert (wrapped.name, wrapped.frame_count, wrapped.skipped) == ("listed", 4, 2)
    assert all(frame.camera is given and frame.image is old.image for frame, old in zip(wrapped, source, strict=True))
    wrapped.close()
    assert source.closed
    (half,) = CalibratedFrames(Listed(frames(1, (320, 240))), given)
    assert half.camera is not None
    assert half.camera.fx == given.fx / 2
    with pytest.raises(InputError, match="640x480 px, these have 640x360"):
        list(CalibratedFrames(Listed(frames(1, (640, 360))), given))


def test_undistorted_frames_carry_the_new_camera() -> None:
    given = camera("EuRoC")
    changing = frames(2, carried=given) + frames(2, (320, 240), given.scaled(320, 240))
    for wrapped in (
        CalibratedFrames(Listed(changing), None, undistort=True),
        CalibratedFrames(Listed(changing), given, undistort=True),
    ):
        seen = list(wrapped)
        assert [frame.image.shape for frame in seen] == [(480, 640)] * 2 + [(240, 320)] * 2
        cameras = [frame.camera for frame in seen]
        assert cameras[0] is cameras[1]
        assert all(model is not None and model.distortion == "none" for model in cameras)
        assert cameras[2] is not None
        assert cameras[2].width == 320
    pinhole = CameraModel(640, 480, 500, 500, 320, 240)
    (same,) = CalibratedFrames(Listed(frames(1)), pinhole, undistort=True)
    assert same.camera is pinhole


def test_undistorting_needs_a_camera() -> None:
    with pytest.raises(ConfigError, match="--calib"):
        list(CalibratedFrames(Listed(frames()), None, undistort=True))
    with pytest.raises(InputError, match="no sense"):
        undistorted_camera(CameraModel(640, 480, 1.0, 1.0, -9e5, 240, "equidistant", np.zeros(4)))


@pytest.mark.parametrize("undistort", [False, True])
def test_a_seekable_source_stays_seekable(undistort: bool) -> None:
    source = Seekable(frames(50))
    wrapped = CalibratedFrames(source, camera("EuRoC"), undistort=undistort)
    assert [frame.index for frame in SelectedFrames(wrapped, start_s=45, end_s=47)] == [45, 46]
    assert source.read == 3

"""Camera models: normalisation and projection invert each other and agree with OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from airline.errors import ConfigError
from frontend.camera.model import CameraModel, Distortion

Coefficients = list[float]

# Calibrations of real lenses, from mild to as strong as they come.
LENSES: dict[str, tuple[Distortion, Coefficients]] = {
    "pinhole": ("none", []),
    "EuRoC": ("radial-tangential", [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]),
    "TUM": ("radial-tangential", [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
    "webcam": ("radial-tangential", [-0.38, 0.18, 0.0015, -0.001, -0.03]),
    "rational": ("radial-tangential", [11.7, 6.2, 0.0004, -0.0003, 0.3, 12.1, 9.8, 1.9]),
    "T265": ("equidistant", [-0.00626, 0.04346, -0.04120, 0.00763]),
    "wide fisheye": ("equidistant", [0.12, -0.05, 0.02, -0.004]),
}


def camera(lens: str, focal: float = 400.0) -> CameraModel:
    kind, coefficients = LENSES[lens]
    return CameraModel(640, 480, focal, 1.02 * focal, 317.3, 244.8, kind, np.array(coefficients))


def opencv_project(model: CameraModel, plane: NDArray[np.float64]) -> NDArray[np.float64]:
    flat = plane.reshape(-1, 2)
    rays, zero = np.column_stack([flat, np.ones(len(flat))]).reshape(-1, 1, 3), np.zeros(3)
    project = cv2.fisheye.projectPoints if model.distortion == "equidistant" else cv2.projectPoints
    pixels = project(rays, zero, zero, model.matrix, model.coefficients)[0]
    return np.asarray(pixels.reshape(plane.shape))


@pytest.mark.parametrize("lens", LENSES)
def test_every_pixel_survives_the_round_trip(lens: str) -> None:
    model = camera(lens)
    pixels = np.stack(np.meshgrid(np.linspace(0, 639, 65), np.linspace(0, 479, 49)), axis=-1).astype(np.float32)
    plane = model.normalize(pixels)
    assert np.isfinite(plane).all()
    # float32 knows the pixel 639 to 3e-5 and the plane to 1e-7 of itself.
    assert np.abs(model.project(plane) - pixels).max() < 2e-4


@pytest.mark.parametrize("lens", LENSES)
@given(points=st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)), min_size=1, max_size=20))
@settings(max_examples=30)
def test_the_plane_survives_the_round_trip_and_agrees_with_opencv(lens: str, points: list[tuple[float, float]]) -> None:
    model, plane = camera(lens), np.array(points)
    pixels = model.project(plane)
    np.testing.assert_allclose(pixels, opencv_project(model, plane), atol=1e-3)
    np.testing.assert_allclose(model.normalize(pixels), plane, atol=2e-6)


@given(
    k1=st.floats(-0.4, 0.4),
    k2=st.floats(-0.2, 0.2),
    p1=st.floats(-0.005, 0.005),
    p2=st.floats(-0.005, 0.005),
    k3=st.floats(-0.1, 0.1),
    x=st.floats(-1.5, 1.5),
    y=st.floats(-1.5, 1.5),
)
@example(k1=-0.125, k2=-0.125, p1=0.0, p2=-0.00390625, k3=0.0, x=-0.9375, y=0.0)  # beyond what the radial part reaches
@settings(max_examples=300)
def test_radial_tangential_is_inverted_or_refused(k1, k2, p1, p2, k3, x, y):
    model = CameraModel(640, 480, 400, 400, 320, 240, "radial-tangential", np.array([k1, k2, p1, p2, k3]))
    plane = np.array([x, y])
    pixel = model.project(plane)
    if np.isfinite(pixel).all():
        again = model.project(model.normalize(pixel))
        if np.isfinite(again).all():
            np.testing.assert_allclose(again, pixel, atol=1e-3 + 1e-5 * np.abs(pixel).max())
    radii = np.hypot(x, y) * np.linspace(0, 1, 200)
    profile = radii * (1 + k1 * radii**2 + k2 * radii**4 + k3 * radii**6)
    if (np.diff(profile) < 0).any():
        assert np.isnan(pixel).all()
    elif (np.diff(profile) > 0.05 * np.diff(radii)).all() and np.hypot(x, y) < 1:
        np.testing.assert_allclose(model.normalize(pixel), plane, atol=1e-4)


@given(st.lists(st.floats(-0.1, 0.1), min_size=4, max_size=4), st.floats(0, 1.5), st.floats(-np.pi, np.pi))
@settings(max_examples=300)
def test_equidistant_is_inverted_or_refused(coefficients: list[float], angle: float, turn: float) -> None:
    model = CameraModel(640, 480, 200, 200, 320, 240, "equidistant", np.array(coefficients))
    pixel = model.project(np.tan(angle) * np.array([np.cos(turn), np.sin(turn)]))
    theta = np.linspace(0, angle, 200)
    moved = theta * (1 + np.stack([theta**2, theta**4, theta**6, theta**8], axis=1) @ np.array(coefficients))
    if (np.diff(moved) < 0).any():
        assert np.isnan(pixel).all()
    elif angle > 0.01 and (np.diff(moved) > 0.05 * np.diff(theta)).all():
        np.testing.assert_allclose(np.hypot(*(pixel - (320, 240))), 200 * moved[-1], atol=1e-3)
        found = model.normalize(pixel)
        assert np.arctan(np.hypot(*found)) == pytest.approx(angle, abs=1e-5)


def test_where_the_image_folds_back_there_is_no_answer() -> None:
    model = CameraModel(640, 480, 400, 400, 320, 240, "radial-tangential", np.array([-0.3, 0.0, 0.0, 0.0]))
    fold = np.sqrt(1 / 0.9)  # where 1 - 3 * 0.3 r^2 = 0
    beyond = model.project(np.array([[0.99 * fold, 0.0], [1.01 * fold, 0.0]]))
    assert np.isfinite(beyond[0]).all()
    assert np.isnan(beyond[1]).all()
    rim = 320 + 400 * fold * (1 - 0.3 * fold**2)
    assert np.isfinite(model.normalize(np.array([rim - 1, 240.0]))).all()
    assert np.isnan(model.normalize(np.array([rim + 1, 240.0]))).all()
    assert np.hypot(*model.normalize(np.array([rim - 1, 240.0]))) < fold


def test_a_fisheye_sees_no_plane_beside_and_behind_itself() -> None:
    model = CameraModel(640, 480, 200, 200, 320, 240, "equidistant", np.zeros(4))
    radii = 200 * np.deg2rad([0, 45, 89, 90.1, 150])
    plane = model.normalize(np.stack([320 + radii, np.full(5, 240.0)], axis=1))
    np.testing.assert_allclose(plane[:3, 0], np.tan(np.deg2rad([0, 45, 89])), rtol=1e-5)
    assert np.isnan(plane[3:]).all()


@pytest.mark.parametrize("lens", LENSES)
def test_arrays_of_any_shape_and_nan(lens: str) -> None:
    model = camera(lens)
    for shape in ((0, 2), (0, 2, 2), (2,), (1, 2, 3, 2)):
        points = np.full(shape, 100.0, np.float32)
        for mapped in (model.normalize(points), model.project(points / 400)):
            assert (mapped.shape, mapped.dtype) == (shape, np.float32)
            assert np.isfinite(mapped).all()
    assert np.isnan(model.normalize(np.array([np.nan, 3.0]))).any()
    np.testing.assert_allclose(model.project(np.zeros(2)), (317.3, 244.8), rtol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("size", [(1280, 960), (200, 333)])
def test_a_scaled_camera_sees_the_same_directions(lens: str, size: tuple[int, int]) -> None:
    model = camera(lens)
    scaled = model.scaled(*size)
    assert (scaled.width, scaled.height) == size
    pixels = np.array([[10.0, 20.0], [400.0, 300.0], [600.0, 100.0]])
    resized = (pixels + 0.5) * np.divide(size, (640, 480)) - 0.5
    np.testing.assert_allclose(scaled.normalize(resized), model.normalize(pixels), atol=1e-6)


def test_wrong_models_are_refused() -> None:
    with pytest.raises(ConfigError, match="4 coefficients"):
        CameraModel(640, 480, 400, 400, 320, 240, "equidistant", np.zeros(5))
    with pytest.raises(ConfigError, match="4 or 5 or 8"):
        CameraModel(640, 480, 400, 400, 320, 240, "radial-tangential", np.zeros(6))
    with pytest.raises(ConfigError, match="positive"):
        CameraModel(640, 480, 0, 400, 320, 240)

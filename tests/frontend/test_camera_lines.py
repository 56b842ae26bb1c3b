"""Lines on the plane z = 1: their coefficients are distances, their covariances what a thousand noisy lines show."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from frontend.camera.model import CameraModel
from frontend.tracks import LineTracks
from tests.frontend.test_camera import camera
from tests.helpers.made_tracks import blank_tracks

SEGMENTS = np.array(
    [[[20, 30], [180, 60]], [[600, 440], [420, 300]], [[300, 20], [310, 460]], [[30, 450], [620, 470]]], np.float32
)
COVARIANCES = np.array([[[0.09, 5e-4], [5e-4, 1e-5]], [[0.04, -2e-4], [-2e-4, 4e-6]]], np.float32)[[0, 1, 1, 0]]


def observed(lens: CameraModel | None, segments: NDArray[np.float32] = SEGMENTS) -> LineTracks:
    covariances = np.resize(COVARIANCES, (len(segments), 2, 2))
    return blank_tracks(len(segments), camera=lens, observed_px=segments, observed_covariances=covariances)


def direction(segments: NDArray[np.float64]) -> NDArray[np.float64]:
    delta = np.asarray(segments[..., 1, :] - segments[..., 0, :])
    return delta / np.linalg.norm(delta, axis=-1, keepdims=True)


@pytest.mark.parametrize("lens", ["pinhole", "wide fisheye", "T265", "webcam", "TUM", "rational"])
def test_covariances_are_those_of_noisy_lines(lens: str) -> None:
    """Lines drawn in pixels, taken through the lens, and compared with the one without noise."""
    model, rng = camera(lens), np.random.default_rng(0)
    tracks = observed(model)
    ends, lines, expected = tracks.observed_normalized, tracks.observed_lines, tracks.observed_line_covariances
    assert ends is not None
    assert lines is not None
    assert expected is not None
    for k, segment in enumerate(np.float64(SEGMENTS)):
        offset, angle = rng.multivariate_normal((0, 0), COVARIANCES[k], 20_000).T
        (ux, uy), half = direction(segment), np.linalg.norm(segment[1] - segment[0]) / 2
        turned = np.stack([np.cos(angle) * ux - np.sin(angle) * uy, np.sin(angle) * ux + np.cos(angle) * uy], axis=1)
        middle = segment.mean(axis=0) + offset[:, None] * (-uy, ux)
        noisy = np.float64(model.normalize(np.stack([middle - half * turned, middle + half * turned], axis=1)))
        (du, dv), (eu, ev) = direction(np.float64(ends[k])), direction(noisy).T
        normal = np.array([-dv, du])
        angles = np.arctan2(du * ev - dv * eu, du * eu + dv * ev)
        # where each noisy line meets the normal through the middle of the true one
        offsets = (noisy[:, 0] - ends[k].mean(axis=0)) @ normal
        offsets -= ((noisy[:, 0] - ends[k].mean(axis=0)) @ (du, dv)) * np.tan(angles)
        found = np.cov(offsets, angles)
        ratio = np.linalg.eigvals(np.linalg.solve(np.float64(expected[k]), found))
        assert np.abs(ratio - 1).max() < 0.05, (k, ratio)
        np.testing.assert_allclose(lines[k, :2], normal, atol=1e-6)


@given(points=st.lists(st.floats(-300, 900, width=16), min_size=4, max_size=4), t=st.floats(-3, 3), d=st.floats(-2, 2))
def test_coefficients_are_signed_distances(points: list[float], t: float, d: float) -> None:
    segments = np.array(points, np.float32).reshape(1, 2, 2)
    if np.linalg.norm(segments[0, 1] - segments[0, 0]) < 5:
        return
    tracks = observed(camera("pinhole"), segments)
    assert tracks.observed_normalized is not None
    assert tracks.observed_lines is not None
    (ends,) = np.float64(tracks.observed_normalized)
    du, dv = direction(ends)
    u, v = ends[0] + t * (ends[1] - ends[0]) + d * np.array([-dv, du])
    a, b, c = map(float, tracks.observed_lines[0])
    assert a * u + b * v + c == pytest.approx(d, abs=2e-5)
    assert a * a + b * b == pytest.approx(1, abs=1e-6)
    assert tracks.observed_lines.dtype == np.float32


def test_a_pinhole_of_one_focal_length_divides_by_it() -> None:
    tracks = observed(CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0))
    np.testing.assert_allclose(
        tracks.observed_line_covariances, COVARIANCES * [[1 / 500**2, 1 / 500], [1 / 500, 1]], rtol=1e-3
    )


def test_without_a_camera_and_beyond_its_lens() -> None:
    unknown = observed(None)
    assert unknown.observed_normalized is unknown.observed_lines is unknown.observed_line_covariances is None
    segments = SEGMENTS.copy()
    segments[1, 1] = 1e6
    segments[2, 1] = segments[2, 0]  # no length, no direction
    tracks = observed(camera("T265"), segments)
    for name, lost in (("observed_normalized", [1]), ("observed_lines", [1, 2]), ("observed_line_covariances", [1, 2])):
        values = getattr(tracks, name)
        assert np.flatnonzero(np.isnan(values).reshape(4, -1).any(axis=1)).tolist() == lost, name
        assert values.dtype == np.float32

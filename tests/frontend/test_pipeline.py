"""The pipeline: what users of the library call."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc

import cv2
import numpy as np
import pytest

from airline import AirLine, CannyEdges, InputError
from airline.scenes import RenderedClip
from frontend import CameraModel, Frame, LineFrontend
from frontend.sources.scene import SceneSource

CLIP = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=12, size=(320, 240))


@pytest.fixture(scope="module")
def frontend():
    return LineFrontend()


def test_streams_a_source_with_its_camera():
    tracks = list(LineFrontend().stream(SceneSource(CLIP)))
    assert [t.frame_index for t in tracks] == list(range(12))
    assert [t.stamp_ns for t in tracks] == [view.stamp_ns for view in CLIP]
    last = tracks[-1]
    assert last.confirmed.sum() > 20
    K = CLIP.K
    expected = (last.segments_px - K[:2, 2]) / np.array([K[0, 0], K[1, 1]])
    assert np.allclose(last.segments_normalized, expected, atol=1e-5)


def test_streams_a_path(tmp_path):
    for view in CLIP.render(0), CLIP.render(1):
        cv2.imwrite(str(tmp_path / f"{view.stamp_ns}.png"), view.image)
    tracks = list(LineFrontend().stream(tmp_path))
    assert len(tracks) == 2
    assert tracks[0].segments_normalized is None, "no camera, no normalised coordinates"
    with pytest.raises(InputError):
        next(LineFrontend().stream(tmp_path / "missing.mp4"))


def test_closes_the_source_when_the_user_stops_early():
    class Source(SceneSource):
        closed = False

        def close(self) -> None:
            self.closed = True

    source = Source(CLIP)
    for _ in LineFrontend(AirLine(edges=CannyEdges())).stream(source):
        break
    assert source.closed


def test_detections_agree_with_the_scenes_truth(frontend):
    """Most of the rendered line length is detected, and most of what is detected is a rendered line."""
    view = RenderedClip(kind="indoor", motion="handheld", seed=3, frames=10).render(5)
    lines = frontend.detector(view.image)

    def mask(segments):
        canvas = np.zeros(view.depth.shape, np.uint8)
        for p in np.rint(segments * 16).astype(int):
            cv2.line(canvas, p[0].tolist(), p[1].tolist(), 255, 1, cv2.LINE_8, 4)
        return canvas > 0

    found, truth = mask(lines.segments), mask(view.segments_px)
    to_truth = cv2.distanceTransform((~truth).astype(np.uint8), cv2.DIST_L2, 5)
    to_found = cv2.distanceTransform((~found).astype(np.uint8), cv2.DIST_L2, 5)
    assert (to_found[truth] <= 2).mean() > 0.8
    assert (to_truth[found] <= 2).mean() > 0.7


def test_warm_up_leaves_no_trace():
    cold, warm = LineFrontend(), LineFrontend()
    views = [CLIP.render(i) for i in range(3)]
    warm.warm_up(views[0].image)
    for index, view in enumerate(views):
        frame = Frame(index, view.stamp_ns, view.image)
        a, b = cold.process(frame).tracks, warm.process(frame).tracks
        assert np.array_equal(a.ids, b.ids)
        assert np.array_equal(a.segments_px, b.segments_px)


def test_memory_does_not_grow_with_the_stream(frontend):
    view = CLIP.render(0)
    for index in range(5):
        frontend.process(Frame(index, index, view.image))
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for index in range(5, 60):
            frontend.process(Frame(index, index, view.image))
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 500_000, f"{grown} bytes in 55 frames"


def test_importing_is_light():
    heavy = ("torch", "numba", "cv2", "rerun")
    code = f"import airline, frontend, logs, viz, sys; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("distortion", ["none", "radial-tangential", "equidistant"])
def test_camera_normalisation_inverts_projection(distortion):
    coefficients = {
        "none": [],
        "radial-tangential": [-0.28, 0.07, 2e-4, 2e-5],
        "equidistant": [-0.01, 0.02, -0.01, 0.002],
    }[distortion]
    camera = CameraModel(752, 480, 458.6, 457.3, 367.2, 248.4, distortion, np.array(coefficients))
    plane = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 2, 2))
    rays = np.concatenate([plane, np.ones((20, 2, 1))], axis=-1).reshape(-1, 1, 3)
    zero = np.zeros(3)
    if distortion == "equidistant":
        pixels = cv2.fisheye.distortPoints(plane.reshape(-1, 1, 2), camera.matrix, camera.coefficients)
    else:
        pixels = cv2.projectPoints(rays, zero, zero, camera.matrix, camera.coefficients if coefficients else None)[0]
    found = camera.normalize(pixels.reshape(20, 2, 2).astype(np.float32))
    assert np.abs(found - plane).max() < 1e-3
    assert camera.normalize(np.zeros((0, 2, 2), np.float32)).shape == (0, 2, 2)


def test_a_scaled_camera_sees_the_same_directions():
    camera = CameraModel(640, 480, 500, 510, 320.3, 239.1)
    half = camera.scaled(320, 240)
    pixel = np.array([[100.0, 50.0]], np.float32)
    scaled = (pixel + 0.5) / 2 - 0.5
    assert np.allclose(camera.normalize(pixel), half.normalize(scaled), atol=1e-6)

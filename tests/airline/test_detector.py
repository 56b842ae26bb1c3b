"""The whole detector on drawn images, of every size and type it promises to take."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from airline import AirLine, CannyEdges, ConfigError, DetectorConfig, InputError, ModuleEdges
from airline.config import EdgeConfig, FitConfig, GrowConfig, OrientationConfig
from airline.image import to_uint8
from airline.stages.fit import TotalLeastSquaresFitter
from airline.stages.orientation import LineKernelOrientation
from airline.stages.pixels import RidgePixels


@pytest.fixture(scope="module")
def airline():
    return AirLine()


def room(width: int = 320, height: int = 240) -> np.ndarray:
    """A grey picture of a few rectangles, scaled to the given size."""
    image = np.full((240, 320), 90, np.uint8)
    cv2.rectangle(image, (40, 50), (150, 200), 180, -1)
    cv2.rectangle(image, (60, 80), (110, 140), 60, -1)
    cv2.rectangle(image, (190, 30), (290, 120), 30, -1)
    cv2.fillConvexPoly(image, np.array([[200, 150], [290, 170], [270, 220], [190, 200]]), 220)
    noise = np.random.default_rng(0).normal(0, 2, image.shape)
    image = np.clip(cv2.GaussianBlur(image, (0, 0), 0.7) + noise, 0, 255).astype(np.uint8)
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC)


def near(segments: np.ndarray, start: tuple[float, float], end: tuple[float, float], tolerance: float) -> bool:
    truth = np.array([start, end])
    both = np.stack([segments, segments[:, ::-1]])
    return bool((np.linalg.norm(both - truth, axis=-1).max(axis=-1) < tolerance).any())


def test_finds_the_sides_of_a_rectangle(airline):
    lines = airline(room())
    n = len(lines)
    for start, end in [
        ((39.5, 49.5), (150.5, 49.5)),
        ((39.5, 49.5), (39.5, 200.5)),
        ((150.5, 49.5), (150.5, 200.5)),
        ((39.5, 200.5), (150.5, 200.5)),
    ]:
        assert near(lines.segments, start, end, 4.0), (start, end)
    assert (lines.segments.shape, lines.scores.shape, lines.descriptors.shape) == ((n, 2, 2), (n,), (n, 6))
    assert {a.dtype for a in (lines.segments, lines.scores, lines.descriptors)} == {np.dtype(np.float32)}
    assert np.allclose(np.linalg.norm(lines.descriptors, axis=1), 1, atol=1e-5)
    assert ((lines.scores > 0) & (lines.scores <= 1)).all()
    assert ((lines.angles >= 0) & (lines.angles < np.pi)).all()
    assert (lines.lengths >= DetectorConfig().fit.min_length - 1e-3).all()


@pytest.mark.parametrize("threads", [1, 2, 8])
def test_batch_gives_what_single_images_give(airline, threads):
    images = [room(), room(200, 150), cv2.merge([room()] * 3), room().astype(np.uint16) * 200] * 3
    found = AirLine(threads=threads, edges=airline.edges).detect_batch(iter(images))
    for lines, image in zip(found, images, strict=True):
        np.testing.assert_array_equal(lines.segments, airline(image).segments)
    assert list(airline.detect_batch([])) == []


def test_batch_takes_images_as_they_are_needed(airline):
    images = iter([room(80, 60)] * 20)
    results = AirLine(threads=8, edges=airline.edges).detect_batch(images)
    for _ in range(3):
        next(results)
    assert len(list(images)) >= 20 - 3 - 8
    results.close()


def test_batch_says_which_image_is_none_after_those_before_it(airline):
    results = airline.detect_batch([room(), np.zeros((5, 5)), room()])
    assert len(next(results)) > 12
    with pytest.raises(InputError, match="float64"):
        next(results)


@pytest.mark.parametrize("preset", ["default", "fast", "accurate", "paper"])
def test_trace_agrees_with_itself(preset):
    detector = AirLine(preset)
    trace = detector.trace(room())
    assert np.array_equal(trace.lines.segments, detector(room()).segments)
    assert set(trace.stage_ms) == {"edges", "pixels", "orientation", "grow", "fit", "refine"}
    assert trace.edges.shape == trace.label_map.shape == (240, 320)
    assert trace.labels.max() == len(trace.lines) - 1
    x, y = trace.pixels.T
    assert np.array_equal(trace.label_map[y, x], trace.labels)
    assert np.array_equal(trace.descriptor_map[y, x], trace.descriptors)
    assert (trace.label_map >= 0).sum() == (trace.labels >= 0).sum()
    for line, (start, end) in enumerate(trace.lines.segments.astype(float)):
        normal = np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start)
        assert np.median(np.abs((trace.region_pixels(line) - start) @ normal)) < 2


@pytest.mark.parametrize("size", [(64, 64), (65, 67), (100, 333), (640, 480), (1241, 376), (3840, 2160)])
def test_takes_any_size(airline, size):
    lines = airline(room(*size))
    assert len(lines) >= 8
    assert (lines.segments >= -0.5).all()
    assert (lines.segments <= np.array(size) - 0.5).all()


@settings(max_examples=25)
@given(st.integers(1, 90), st.integers(1, 90), st.integers(0, 10**6))
def test_small_images_of_noise_never_fail(height, width, seed):
    image = np.random.default_rng(seed).integers(0, 256, (height, width), np.uint8)
    for preset in ("default", "paper"):
        assert np.isfinite(AirLine(preset, edges=CannyEdges())(image).segments).all()


def test_grey_colour_alpha_and_views_of_larger_arrays_agree(airline):
    grey = room()
    expected = airline(grey).segments
    big = np.zeros((300, 400), np.uint8)
    big[20:260, 30:350] = grey
    for image in (*(np.repeat(grey[:, :, None], channels, 2) for channels in (1, 3, 4)), big[20:260, 30:350]):
        assert np.array_equal(airline(image).segments, expected)


@pytest.mark.parametrize("factor", [257, 16, 1])
def test_uint16_of_any_range_finds_the_same(factor):
    airline = AirLine(runtime="torch")  # bfloat16 rounds both differently
    image = room()
    eight, sixteen = airline(image), airline(image.astype(np.uint16) * factor)
    assert len(eight) == len(sixteen)
    assert all(near(sixteen.segments, *segment, 0.1) for segment in eight.segments)


def test_flat_images_have_no_lines(airline):
    for level in (0, 128, 255):
        assert len(airline(np.full((120, 160), level, np.uint8))) == 0


@pytest.mark.parametrize(
    ("image", "complaint"),
    [
        (np.zeros((10, 10), np.float32), "dtype float32"),
        (np.zeros((10, 10, 2), np.uint8), "shape"),
        (np.zeros((0, 10), np.uint8), "shape"),
        (np.zeros(10, np.uint8), "shape"),
    ],
)
def test_refuses_what_is_no_image(airline, image, complaint):
    with pytest.raises(InputError, match=complaint):
        airline(image)


def test_canny_is_a_second_edge_detector():
    lines = AirLine(config=DetectorConfig(edges=EdgeConfig(detector="canny")))(room())
    left = lines.segments[(np.abs(lines.segments[:, :, 0] - 39.5) < 1.5).all(axis=1), :, 1]
    assert np.abs(left[:, 1] - left[:, 0]).sum() > 0.9 * 150, "the left side, in one piece or more"


def test_any_torch_module_is_an_edge_detector():
    module = torch.nn.Conv2d(3, 1, 3, padding=1)
    edges = ModuleEdges(module, channels=3, scale=1.0).detect(room(160, 128))
    assert edges.shape == (128, 160)
    assert edges.dtype == np.float32
    assert ((edges >= 0) & (edges <= 1)).all()
    with pytest.raises(ConfigError, match=r"must answer \(1, 1, H, W\) logits"):
        ModuleEdges(torch.nn.MaxPool2d(2)).detect(room())


def test_stages_on_their_own_begin_as_the_default_preset():
    detector = AirLine(edges=CannyEdges())
    assert detector.fitter == TotalLeastSquaresFitter()
    assert detector.orientation == LineKernelOrientation()
    assert detector.pixels == RidgePixels()
    assert AirLine(edges=ModuleEdges(torch.nn.Identity())).pixels == RidgePixels()


def test_any_stage_may_be_replaced(airline):
    """With an object that has its one method."""

    class Halves:
        def fit(self, edge, descriptors, regions):
            lines, labels = airline.fitter.fit(edge, descriptors, regions)
            return replace(lines, scores=lines.scores / 2), labels

    detector = AirLine(edges=airline.edges)
    detector.fitter = Halves()
    assert np.array_equal(detector(room()).scores, airline(room()).scores / 2)


def test_edges_and_the_other_stages_one_after_the_other(airline):
    edges, gray, milliseconds = airline.detect_edges(cv2.merge([room()] * 3))
    assert np.array_equal(gray, room())
    assert milliseconds > 0
    trace = airline.trace_edges(edges, gray, milliseconds)
    assert trace.stage_ms["edges"] == milliseconds
    assert np.array_equal(trace.lines.segments, airline(room()).segments)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: AirLine("fancy"), "no preset named 'fancy'"),
        (lambda: GrowConfig(similarity=1.1), "setting similarity: .*<= 1.0"),
        (lambda: GrowConfig(min_pixels=0), "setting min_pixels"),
        (lambda: OrientationConfig(channels=1), "setting channels"),
        (lambda: OrientationConfig(kernel_size=8), "odd kernel size"),
        (lambda: EdgeConfig(smoothing=4), "odd number of pixels"),
        (lambda: FitConfig(max_deviation=0), "setting max_deviation"),
        (lambda: CannyEdges(low=100, high=50), "low <= high"),
    ],
)
def test_impossible_settings_are_refused(make, complaint):
    with pytest.raises(ConfigError, match=complaint):
        make()


def test_sixteen_bit_images_are_stretched_despite_hot_pixels():
    ramp = np.tile(np.linspace(1000, 3000, 256).astype(np.uint16), (64, 1))
    ramp[0, 0] = 65535
    picture = to_uint8(ramp)
    assert picture.dtype == np.uint8
    assert (picture[32].min(), picture[32].max()) == (0, 255)
    assert int(picture[32, 128]) == pytest.approx(128, abs=4)

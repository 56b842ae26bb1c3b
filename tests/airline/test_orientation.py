"""The orientation stage against a plain convolution."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.config import OrientationConfig
from airline.stages.orientation import GradientOrientation, LineKernelOrientation, line_kernels


def everywhere(height: int, width: int) -> np.ndarray:
    y, x = np.mgrid[:height, :width]
    return np.stack([x.ravel(), y.ravel()], axis=1).astype(np.int32)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    height=st.integers(1, 30),
    width=st.integers(1, 30),
    channels=st.sampled_from([2, 6, 12]),
    size=st.sampled_from([3, 5, 11]),
    subtract_mean=st.booleans(),
)
def test_agrees_with_conv2d(seed, height, width, channels, size, subtract_mean):
    edges = np.random.default_rng(seed).random((height, width)).astype(np.float32)
    config = OrientationConfig(channels=channels, kernel_size=size, subtract_mean=subtract_mean)
    found = LineKernelOrientation(config).describe(
        edges, np.zeros((height, width), np.uint8), everywhere(height, width)
    )
    kernels = torch.from_numpy(line_kernels(channels, size))[:, None].double()
    expected = torch.nn.functional.conv2d(torch.from_numpy(edges)[None, None].double(), kernels, padding=size // 2)
    if subtract_mean:
        expected = expected - expected.mean(dim=1, keepdim=True)
    # the less is left of the sums when their mean is gone, the more of it is rounding
    strength = expected.norm(dim=1)[0].numpy().ravel()
    unit = torch.nn.functional.normalize(expected, dim=1)[0].permute(1, 2, 0).reshape(-1, channels).numpy()
    assert (np.abs(found - unit).max(axis=1, initial=0) * strength).max(initial=0) < 1e-5


@pytest.mark.parametrize("channels", [2, 4, 6, 12])
@pytest.mark.parametrize("size", [7, 9])
def test_kernels_are_centred_lines_at_even_angles(channels, size):
    kernels = line_kernels(channels, size)
    assert (kernels.sum(axis=(1, 2)) == size).all()
    assert np.array_equal(kernels, kernels[:, ::-1, ::-1])
    y, x = np.mgrid[:size, :size] - size // 2
    for n, kernel in enumerate(kernels):
        xx, xy, yy = (float((kernel * p).sum()) for p in (x * x, x * y, y * y))
        angle = np.degrees(0.5 * np.arctan2(2 * xy, xx - yy)) % 180
        assert min(abs(angle - n * 180 / channels), 180 - abs(angle - n * 180 / channels)) < 5


def test_an_empty_map_gives_zeros_not_nan():
    found = LineKernelOrientation().describe(np.zeros((5, 5), np.float32), np.zeros((5, 5), np.uint8), everywhere(5, 5))
    assert (found == 0).all()


def test_image_gradient_points_across_the_edge():
    image = np.zeros((20, 20), np.uint8)
    image[:, 10:] = 200
    found = GradientOrientation().describe(np.zeros((20, 20), np.float32), image, np.array([[10, 10]], np.int32))
    assert found[0] == pytest.approx([1, 0], abs=1e-6)

"""The image as the network's input and its answer as an edge map, against torch's own operations."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.kernels.threads import ALONE, Team
from airline.network.encoding import fold, folded_size, unfold
from airline.network.spec import UNetSpec
from airline.network.unet import UNet, normalise

SPECS = st.builds(
    UNetSpec,
    widths=st.integers(1, 4).map(lambda levels: (4,) * levels),
    unshuffle=st.sampled_from([1, 2, 4]),
    smoothed=st.integers(0, 3),
)


@settings(max_examples=60, deadline=None)
@given(
    spec=SPECS,
    height=st.integers(1, 70),
    width=st.integers(1, 70),
    depth=st.sampled_from([np.uint8, np.uint16]),
    seed=st.integers(0, 99),
)
def test_fold(spec: UNetSpec, height: int, width: int, depth: type, seed: int) -> None:
    """Every size, also those that are no multiples of the network's stride."""
    gray = np.random.default_rng(seed).integers(0, np.iinfo(depth).max, (height, width), depth)
    image = normalise(torch.from_numpy(gray.astype(np.float32))[None, None])
    beyond = (0, -width % spec.stride, 0, -height % spec.stride)
    blocks = torch.nn.functional.pixel_unshuffle(
        torch.nn.functional.pad(image, beyond, mode="replicate"), spec.unshuffle
    )
    expected = torch.cat([blocks, *UNet(spec)._smoothed(blocks)], dim=1).numpy()
    planes, of_bfloat16 = (
        np.full((*expected.shape[2:], expected.shape[1]), 7, kind) for kind in (np.uint32, np.uint16)
    )
    assert planes.shape[:2] == folded_size(spec, height, width)
    fold(gray, spec, planes)
    np.testing.assert_allclose(planes.view(np.float32).transpose(2, 0, 1)[None], expected, atol=1e-4)
    rounded = torch.from_numpy(planes.view(np.float32)).to(torch.bfloat16)
    fold(gray, spec, of_bfloat16)
    assert np.array_equal(of_bfloat16, rounded.view(torch.uint16).numpy())


@pytest.mark.parametrize("side", [1, 2])
def test_a_team_folds_and_unfolds_like_one_thread(side: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts that are smaller than the smoothed copies' reach, too."""
    monkeypatch.setattr("airline.network.encoding.LEAST_ROWS", 1)
    spec = UNetSpec((16, 32), unshuffle=side, smoothed=3)
    gray = np.random.default_rng(0).integers(0, 255, (11 * side, 40), np.uint8)
    rows, columns = folded_size(spec, *gray.shape)
    alone, shared = (np.zeros((rows, columns, side * side + 3), np.uint16) for _ in range(2))
    fold(gray, spec, alone)
    fold(gray, spec, shared, Team(4))
    assert np.array_equal(alone, shared)
    logits = alone[:, :, : side * side].copy()
    one, many = (unfold(logits, side, *gray.shape, team) for team in (ALONE, Team(4)))
    assert np.array_equal(one, many)


def test_a_flat_image_becomes_zeros() -> None:
    planes = np.ones((32, 32, 6), np.uint32)
    fold(np.full((20, 30), 77, np.uint8), UNetSpec(), planes)
    assert not planes.any()


@settings(max_examples=60, deadline=None)
@given(
    side=st.sampled_from([1, 2, 4]),
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    margin=st.integers(0, 3),
    seed=st.integers(0, 99),
)
def test_unfold(side: int, height: int, width: int, margin: int, seed: int) -> None:
    rows, columns = (-(-length // side) + margin for length in (height, width))
    logits = np.random.default_rng(seed).normal(0, 6, (rows, columns, side * side)).astype(np.float32)
    shuffled = torch.nn.functional.pixel_shuffle(torch.from_numpy(logits.transpose(2, 0, 1)[None]), side)
    expected = torch.sigmoid(shuffled)[0, 0, :height, :width].numpy()
    edges = unfold(logits.view(np.uint32), side, height, width)
    assert edges.dtype == np.float32
    np.testing.assert_allclose(edges, expected, atol=1e-5)
    rounded = torch.from_numpy(logits).to(torch.bfloat16)
    of_bfloat16 = unfold(rounded.view(torch.uint16).numpy(), side, height, width)
    of_float32 = unfold(rounded.float().numpy().view(np.uint32), side, height, width)
    np.testing.assert_allclose(of_bfloat16, of_float32, atol=1e-5)


@pytest.mark.parametrize("logit", [-np.inf, -1e30, -50, 50, 1e30, np.inf])
def test_probabilities_stay_between_0_and_1(logit: float) -> None:
    logits = np.full((4, 4, 4), logit, np.float32).view(np.uint32)
    assert unfold(logits, 2, 8, 8) == pytest.approx(float(logit > 0), abs=1e-5)

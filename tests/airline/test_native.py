"""The edge network in vector code of our own: torch's edges, with any instructions, size, shape and threads."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.errors import ConfigError
from airline.network.native import network as native
from airline.network.native.network import NativeNetwork
from airline.network.native.quantise import LARGEST, MOST, quantise
from airline.network.runtimes import AVX2, AVX2_VNNI, AVX512_VNNI, Isa, _has, open_network, vector_instructions
from airline.network.spec import UNetSpec
from airline.network.torch_runtimes import TorchNetwork
from airline.network.unet import UNet, measure_ranges
from airline.network.weights import load_ranges, load_weights, save_unet
from tests.helpers.pictures import pictures

if vector_instructions() is None:
    pytest.skip("needs a processor with AVX2", allow_module_level=True)

# with what each needs: the narrower ones are run by whoever has the wider ones
ISAS = {"AVX512_VNNI": (AVX512_VNNI, "avx512vnni"), "AVX2_VNNI": (AVX2_VNNI, "avx512vnni"), "AVX2": (AVX2, "avx2")}


def with_instructions(weights: str | Path, isa: Isa, monkeypatch: pytest.MonkeyPatch) -> NativeNetwork:
    monkeypatch.setattr(native, "vector_instructions", lambda: isa)
    return NativeNetwork(weights, 2)


def assert_close(ours: np.ndarray, theirs: np.ndarray, most: float = 0.2, mean: float = 0.012) -> None:
    """`most` holds for all but one pixel in 10,000."""
    assert ours.shape == theirs.shape
    assert ours.dtype == theirs.dtype == np.float32
    difference = np.abs(ours - theirs)
    assert np.quantile(difference, 1 - 1e-4, method="lower") <= most
    assert difference.mean() <= mean


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("weights", ["default", "fast", "accurate"])
def test_agrees_with_torch(scene: np.ndarray, weights: str, isa: str, monkeypatch: pytest.MonkeyPatch) -> None:
    instructions, feature = ISAS[isa]
    if not _has(feature):
        pytest.skip(f"needs a processor with {feature}")
    ours, theirs = with_instructions(weights, instructions, monkeypatch), TorchNetwork(weights)
    for image in pictures(scene):
        assert_close(ours(image), theirs(image), *((0.2, 0.012) if instructions[1] else (0.35, 0.02)))


@pytest.fixture(scope="module")
def networks() -> tuple[NativeNetwork, TorchNetwork]:
    """Ours and theirs."""
    return NativeNetwork("fast"), TorchNetwork("fast")


@given(height=st.integers(1, 70), width=st.integers(1, 70), seed=st.integers(0, 99))
@settings(max_examples=25)
def test_any_size(networks: tuple[NativeNetwork, TorchNetwork], height: int, width: int, seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width), np.uint8)
    ours, theirs = (network(image) for network in networks)
    assert_close(ours, theirs, mean=0.02)


GUARD = 4096  # bytes


@pytest.mark.parametrize(
    "spec", [UNetSpec((12, 20), smoothed=1), UNetSpec((3, 9, 4), smoothed=4), UNetSpec((8, 16, 24, 8, 8), smoothed=0)]
)
def test_every_shape_of_network(tmp_path: Path, spec: UNetSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    """Channels that fill no group and no block among them; compiled code writes nowhere beyond the maps."""
    made = []

    def guarded(shape: tuple[int, ...]) -> np.ndarray:
        size = math.prod(shape)
        made.append(np.full(size + 2 * GUARD, 171, np.uint8))
        made[-1][GUARD:-GUARD] = 0
        return made[-1][GUARD:-GUARD].reshape(shape)

    monkeypatch.setattr(native, "_room", guarded)
    torch.manual_seed(1)
    rng, net = np.random.default_rng(0), UNet(spec).eval()
    images = [rng.integers(0, 256, size, np.uint8) for size in [(100, 90), *rng.integers(1, 140, (9, 2))]]
    save_unet(net, tmp_path / "net.safetensors", measure_ranges(net, images[:1]))
    for isa, feature in ISAS.values():
        if _has(feature):
            found = [*map(with_instructions(tmp_path / "net.safetensors", isa, monkeypatch), images)]
            assert_close(found[0], TorchNetwork(net)(images[0]), 0.05, 0.005)
    assert len(made) > 20
    assert all((room[:GUARD] == 171).all() and (room[-GUARD:] == 171).all() for room in made)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("level", [0, 1])
def test_flat_and_harsh_images(networks: tuple[NativeNetwork, TorchNetwork], level: int, kind: type) -> None:
    most = np.iinfo(kind).max
    flat = np.full((64, 96), level * most, kind)
    half, single = flat.copy(), flat.copy()
    half[:, 48:] = (1 - level) * most
    for image in (flat, half):
        assert_close(networks[0](image), networks[1](image))
    single[30, 40] = (1 - level) * most  # 78 deviations from the mean, more than 8 bits hold
    edges = networks[0](single)
    assert ((edges >= 0) & (edges <= 1)).all()
    assert edges[28:33, 38:43].max() > 0.15, "it is seen"


@pytest.mark.parametrize("name", ["default", "fast", "accurate"])
def test_no_sum_of_products_leaves_32_bits(name: str) -> None:
    assert 2 * MOST * 63 < 1 << 15, "without VNNI two products are added in 16 bits"
    spec, weights = load_weights(name)
    for largest in (63, 127):
        quantised = quantise(spec, weights, load_ranges(name), largest)
        for layer in (*quantised.down, *quantised.lateral, *quantised.up, quantised.head):
            sizes = np.abs(layer.weights.astype(np.int64))
            assert sizes.max() == largest
            assert MOST * sizes.sum(axis=(1, 2, 4)).max() < 1 << 31
        words = np.abs(quantised.copies.weights.astype(np.int64)).sum(axis=(1, 2, 4))
        assert (LARGEST + 1) * words.max() < 1 << 31


def test_any_number_of_threads_gives_the_same_bits(scene: np.ndarray) -> None:
    """Also where there are more threads than rows."""
    images = [scene, scene[:1], scene[:7, :31], scene[:130]]
    alone = NativeNetwork("default", 1)
    for threads in (2, 3, 4, 5):
        team = NativeNetwork("default", threads)
        for image in images:
            np.testing.assert_array_equal(team(image), alone(image))


def test_what_it_cannot_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_unet(UNet(UNetSpec((4, 8))), tmp_path / "no_ranges.safetensors")
    deep = UNet(UNetSpec((4, 8), convs=2)).eval()
    save_unet(deep, tmp_path / "two_convs.safetensors", measure_ranges(deep, [np.zeros((64, 64), np.uint8)]))
    for name in ("no_ranges", "two_convs"):
        path = tmp_path / f"{name}.safetensors"
        with pytest.raises(ConfigError, match="8-bit numbers: use --runtime auto"):
            open_network(path, "native")
        assert not open_network(path).name.startswith("native")
    monkeypatch.setattr(native, "vector_instructions", lambda: None)
    with pytest.raises(ConfigError, match="lacks AVX2"):
        open_network("fast", "native")
    assert not open_network("fast").name.startswith("native")


def test_maps_of_zeros_have_ranges_that_work(tmp_path: Path) -> None:
    """What little training may leave: a layer that never answers."""
    torch.manual_seed(4)
    net = UNet(UNetSpec((4, 8))).eval()
    with torch.no_grad():
        net.down[0][0].bias.fill_(-1000)
        net.up[0][0].bias.fill_(-1000)
    image = np.random.default_rng(0).integers(0, 256, (64, 64), np.uint8)
    ranges = measure_ranges(net, [image])
    assert ranges["down.1.0"] == ranges["head"] == (0, 0)
    save_unet(net, tmp_path / "net.safetensors", ranges)
    np.testing.assert_allclose(NativeNetwork(tmp_path / "net.safetensors")(image), TorchNetwork(net)(image), atol=1e-3)

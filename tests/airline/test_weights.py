"""Weights files: strict, checked, never unpickled."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

import airline.network.weights
from airline import WeightsError
from airline.network.spec import UNetSpec
from airline.network.unet import BEYOND, UNet, measure_ranges, normalise
from airline.network.weights import BUNDLED, bundled_path, load_ranges, load_unet, load_weights, save_unet

WRONG = ["[]", "[true]", "16", "[16", "[0]", "[" * 9999, "[4, 4, 4, 4, 4, 4, 4, 4, 4]"]
ONE = '"up.0.0": [0, 1], "lateral.0": [0, 1], "down.1.0": [0, 1]'


def convolutions(spec):
    """All but the first, whose input is the image."""
    return {name.removesuffix(".weight") for name in spec.shapes() if name.endswith(".weight")} - {"down.0.0"}


@pytest.mark.parametrize("name", BUNDLED)
def test_bundled_weights(name):
    net, ranges = load_unet(name), load_ranges(name)
    assert not net.training
    assert bundled_path(name).stat().st_size < 5_000_000
    assert ranges.keys() == convolutions(net.spec)
    assert all(low <= 0 < high for low, high in ranges.values())


def test_round_trip_folds_the_normalisation(tmp_path):
    torch.manual_seed(0)
    net = UNet(UNetSpec((8, 16, 32), convs=2), norm=True)
    with torch.no_grad():
        for _ in range(3):  # move the running statistics away from their start
            net(torch.randn(2, 1, 64, 64) * 3 + 1)
    net.eval()
    notes = {name: name.upper() for name in "abcdefgh"}
    files = {save_unet(net, tmp_path / f"{number}.safetensors", **notes) for number in range(5)}
    assert len(files) == 1, "equal weights make equal files"
    loaded = load_unet(tmp_path / "0.safetensors")
    assert loaded.spec == net.spec
    image = torch.randn(1, 1, 32, 48)
    assert torch.allclose(loaded(image), net(image), atol=1e-4)


def test_a_damaged_bundled_file_is_refused(tmp_path, monkeypatch):
    data = bytearray(bundled_path("default").read_bytes())
    data[-5] ^= 1
    (tmp_path / "default.safetensors").write_bytes(data)
    monkeypatch.setattr(airline.network.weights, "bundled_path", lambda name: tmp_path / f"{name}.safetensors")
    with pytest.raises(WeightsError, match="SHA-256"):
        load_unet("default")


@pytest.mark.parametrize("keep", [0, 4, 8, 100, 5000, 100_000])
def test_a_truncated_file_is_refused(tmp_path, keep):
    path = tmp_path / "cut.safetensors"
    path.write_bytes(bundled_path("default").read_bytes()[:keep])
    with pytest.raises(WeightsError, match="not a readable safetensors file"):
        load_unet(path)
    with pytest.raises(WeightsError, match=r"no weights file .*nowhere"):
        load_unet(tmp_path / "nowhere.safetensors")


def test_a_pickle_is_refused(tmp_path):
    path = tmp_path / "weights.pt"
    path.write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises(WeightsError, match="not a readable safetensors file"):
        load_unet(path)


@pytest.mark.parametrize(
    ("metadata", "why"),
    [
        (None, "widths"),
        (UNetSpec().to_metadata(), "its tensors differ"),
        (UNetSpec((10**6,)).to_metadata(), "1024"),
        *(({**UNetSpec().to_metadata(), "widths": widths}, "") for widths in WRONG),
    ],
)
def test_weights_of_another_network_are_refused(tmp_path, metadata, why):
    path = tmp_path / "other.safetensors"
    save_file({"a": torch.zeros(3)}, path, metadata=metadata)
    with pytest.raises(WeightsError, match=f"does not hold weights of this edge network.*{why}"):
        load_weights(path)


def test_weights_that_are_not_numbers_are_refused(tmp_path):
    net = UNet(UNetSpec())
    with torch.no_grad():
        net.head.bias[0] = float("nan")
    save_unet(net, tmp_path / "nan.safetensors")
    with pytest.raises(WeightsError, match="not finite"):
        load_weights(tmp_path / "nan.safetensors")


def test_ranges_are_kept_in_the_file(tmp_path):
    net = UNet(UNetSpec((4, 8)))
    ranges = {name: (-1.25, 2.5) for name in convolutions(net.spec)}
    save_unet(net, tmp_path / "with.safetensors", ranges)
    save_unet(net, tmp_path / "without.safetensors")
    assert load_ranges(tmp_path / "with.safetensors") == ranges
    assert load_ranges(tmp_path / "without.safetensors") == {}


@pytest.mark.parametrize(
    "ranges",
    ["[1, 2]", '{"head": [0, 1]}', "no JSON", "[" * 100_000]
    + [f'{{"head": {head}, {ONE}}}' for head in ("1", "[NaN, 1]", "[2, 1]", "[0, 1e9]", '["a", "b"]', "[0, 1, 2]")],
)
def test_ranges_that_are_none_are_refused(tmp_path, ranges):
    path, spec = tmp_path / "net.safetensors", UNetSpec((4, 8))
    save_file(UNet(spec).state_dict(), path, metadata={**spec.to_metadata(), "ranges": ranges})
    with pytest.raises(WeightsError, match="does not hold weights of this edge network"):
        load_ranges(path)


def test_ranges_hold_all_numbers_but_a_few(scene):
    torch.manual_seed(3)
    net = UNet(UNetSpec((4, 8, 16), convs=2, unshuffle=1, smoothed=0)).eval()
    images = [scene, np.ascontiguousarray(scene[::2, ::2])]
    ranges = measure_ranges(net, images)
    assert ranges.keys() == convolutions(net.spec)
    low, high = ranges["down.1.0"]
    with torch.no_grad():
        for image in images:
            first = net.down[0](normalise(torch.from_numpy(image.astype(np.float32))[None, None]))
            taken = torch.nn.functional.max_pool2d(first, 2)
            assert (taken > high * (1 + 1e-5)).float().mean() <= BEYOND  # what is equal but for rounding is within
    assert low == 0, "what comes from a ReLU is never negative"
    assert ranges["up.0.0"][0] < 0, "what is added may be"

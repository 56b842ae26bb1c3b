"""Weights files: strict, checked, never unpickled."""

from __future__ import annotations

import pickle
import shutil

import pytest
import torch

import airline.network.weights
from airline import UNetEdges, WeightsError
from airline.network.spec import UNetSpec
from airline.network.unet import UNet
from airline.network.weights import BUNDLED, bundled_path, load_unet, save_unet


def test_bundled_weights_load():
    for name in BUNDLED:
        net = load_unet(name)
        assert not net.training
        assert bundled_path(name).stat().st_size < 5_000_000


def test_round_trip_folds_the_normalisation(tmp_path):
    torch.manual_seed(0)
    net = UNet(UNetSpec((8, 16, 32), convs=2), norm=True)
    with torch.no_grad():
        for _ in range(3):  # move the running statistics away from their start
            net(torch.randn(2, 1, 64, 64) * 3 + 1)
    net.eval()
    save_unet(net, tmp_path / "net.safetensors", note="a test")
    loaded = load_unet(tmp_path / "net.safetensors")
    assert loaded.spec == net.spec
    image = torch.randn(1, 1, 32, 48)
    assert torch.allclose(loaded(image), net(image), atol=1e-4)


def test_smoothed_copies_of_the_image():
    net = UNet(UNetSpec((8, 16), smoothed=2))
    image = torch.zeros(1, 4, 13, 13)
    image[0, :, 6, 6] = 45  # a point of light, the same in all four folded pixels
    first, second = (copy[0, 0] for copy in net._smoothed(image))
    expected = torch.zeros(13, 13)
    expected[5:8, 5:8] = 2 * 5.0
    assert torch.allclose(first, expected, atol=1e-5)
    assert second[6, 6] == pytest.approx(2 * 9 * 5 / 25)
    assert second.sum() == pytest.approx(2 * 45.0, rel=1e-5)
    assert (second[:1] == 0).all()
    flat = net._smoothed(torch.full((1, 4, 9, 9), 3.0))
    assert all(torch.allclose(copy, torch.tensor(6.0)) for copy in flat), "borders lose no light"
    assert UNet(UNetSpec((8, 16), smoothed=0))._smoothed(image) == []


def test_equal_weights_make_equal_files(tmp_path):
    net = UNet(UNetSpec((8, 16)))
    notes = {name: name.upper() for name in "abcdefgh"}
    assert len({save_unet(net, tmp_path / f"{i}.safetensors", **notes) for i in range(5)}) == 1


def test_a_damaged_bundled_file_is_refused(tmp_path, monkeypatch):
    data = bytearray(bundled_path("default").read_bytes())
    data[-5] ^= 1
    (tmp_path / "default.safetensors").write_bytes(data)
    monkeypatch.setattr(airline.network.weights, "bundled_path", lambda name: tmp_path / f"{name}.safetensors")
    with pytest.raises(WeightsError, match="SHA-256"):
        load_unet("default")


def test_a_missing_file_is_refused():
    with pytest.raises(WeightsError, match=r"no weights file .*nowhere"):
        load_unet("nowhere.safetensors")


@pytest.mark.parametrize("keep", [0, 4, 8, 100, 5000, 100_000])
def test_a_truncated_file_is_refused(tmp_path, keep):
    path = tmp_path / "cut.safetensors"
    path.write_bytes(bundled_path("default").read_bytes()[:keep])
    with pytest.raises(WeightsError, match="not a readable safetensors file"):
        load_unet(path)


def test_a_pickle_is_refused(tmp_path):
    path = tmp_path / "weights.pt"
    path.write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises(WeightsError, match="not a readable safetensors file"):
        load_unet(path)


def test_weights_of_another_network_are_refused(tmp_path):
    from safetensors.torch import save_file

    path = tmp_path / "other.safetensors"
    save_file({"a": torch.zeros(3)}, path)
    with pytest.raises(WeightsError, match="does not hold weights of this edge network"):
        load_unet(path)
    save_file({"a": torch.zeros(3)}, path, metadata=UNetSpec().to_metadata())
    with pytest.raises(WeightsError, match="does not hold weights of this edge network"):
        load_unet(path)
    save_file({"a": torch.zeros(3)}, path, metadata=UNetSpec((10**6,)).to_metadata())
    with pytest.raises(WeightsError, match="out of range"):
        load_unet(path)


@pytest.mark.parametrize(
    "widths", ["[]", "[true]", "[1.5]", "16", '{"a": 1}', "[16", "[0]", "[" * 9999, "[4, 4, 4, 4, 4, 4, 4, 4, 4]"]
)
def test_shapes_that_are_none_are_refused(tmp_path, widths):
    from safetensors.torch import save_file

    path = tmp_path / "other.safetensors"
    save_file({"a": torch.zeros(3)}, path, metadata={**UNetSpec().to_metadata(), "widths": widths})
    with pytest.raises(WeightsError, match="does not hold weights of this edge network"):
        load_unet(path)


def test_weights_that_are_not_numbers_are_refused(tmp_path):
    net = UNet(UNetSpec())
    with torch.no_grad():
        net.head.bias[0] = float("nan")
    save_unet(net, tmp_path / "nan.safetensors")
    with pytest.raises(WeightsError, match="not finite"):
        load_unet(tmp_path / "nan.safetensors")


def test_a_copy_of_the_bundled_weights_works_as_a_file(tmp_path):
    shutil.copy(bundled_path("default"), tmp_path / "copy.safetensors")
    UNetEdges(tmp_path / "copy.safetensors", runtime="torch")

"""The edge network in OpenVINO, and the image as its input and its answer as an edge map, against torch."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.network.processor import has_bf16
from airline.network.spec import SIZES, SPECS, UNetSpec
from airline.network.torch_runtimes import TorchNetwork
from airline.network.unet import UNet, normalise
from airline.network.weights import save_unet
from tests.helpers.edges import assert_close, pictures

pytest.importorskip("openvino")
from airline.network.openvino_cpu import OpenVinoNetwork, decode_output, encode_input

SPEC = st.builds(
    UNetSpec,
    widths=st.integers(1, 4).map(lambda levels: (4,) * levels),
    unshuffle=st.sampled_from([1, 2, 4]),
    smoothed=st.integers(0, 3),
)


def in_float32(weights: str | Path) -> OpenVinoNetwork:
    network = OpenVinoNetwork(weights)
    network._precision = "f32"
    return network


@settings(max_examples=60, deadline=None)
@given(
    spec=SPEC,
    height=st.integers(1, 70),
    width=st.integers(1, 70),
    depth=st.sampled_from([np.uint8, np.uint16]),
    seed=st.integers(0, 99),
)
def test_encode_input(spec: UNetSpec, height: int, width: int, depth: type, seed: int) -> None:
    """Every size, also those that are no multiples of the network's stride."""
    gray = np.random.default_rng(seed).integers(0, np.iinfo(depth).max, (height, width), depth)
    image = normalise(torch.from_numpy(gray.astype(np.float32))[None, None])
    beyond = (0, -width % spec.stride, 0, -height % spec.stride)
    filled = torch.nn.functional.pad(image, beyond, mode="replicate")
    blocks = torch.nn.functional.pixel_unshuffle(filled, spec.unshuffle)
    expected = torch.cat([blocks, *UNet(spec)._smoothed(blocks)], dim=1).numpy()
    planes = np.full((*spec.folded_size(height, width), expected.shape[1]), 7, np.float32)
    encode_input(gray, spec, planes)
    np.testing.assert_allclose(planes.transpose(2, 0, 1)[None], expected, atol=1e-4)


def test_a_flat_image_becomes_zeros() -> None:
    planes = np.ones((32, 32, 6), np.float32)
    encode_input(np.full((20, 30), 77, np.uint8), UNetSpec(), planes)
    assert not planes.any()


@settings(max_examples=60, deadline=None)
@given(
    side=st.sampled_from([1, 2, 4]),
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    margin=st.integers(0, 3),
    seed=st.integers(0, 99),
)
def test_decode_output(side: int, height: int, width: int, margin: int, seed: int) -> None:
    rows, columns = (-(-length // side) + margin for length in (height, width))
    logits = np.random.default_rng(seed).normal(0, 6, (rows, columns, side * side)).astype(np.float32)
    logits[0, 0] = np.random.default_rng(seed).choice([-np.inf, -1e30, 1e30, np.inf], side * side)
    shuffled = torch.nn.functional.pixel_shuffle(torch.from_numpy(logits.transpose(2, 0, 1)[None]), side)
    edges = decode_output(logits, height, width)
    assert edges.dtype == np.float32
    np.testing.assert_allclose(edges, torch.sigmoid(shuffled)[0, 0, :height, :width].numpy(), atol=1e-5)


@pytest.mark.parametrize("weights", ["default", "fast", "accurate"])
def test_agrees_with_torch(scene: np.ndarray, weights: str) -> None:
    theirs = TorchNetwork(weights)
    for ours, precision in ((in_float32(weights), "f32"), (OpenVinoNetwork(weights), "bf16")):
        for image in pictures(scene):
            assert_close(ours(image), theirs(image), precision)


def test_works_in_what_the_processor_is_made_for(monkeypatch: pytest.MonkeyPatch) -> None:
    assert OpenVinoNetwork("fast").name == ("openvino bf16" if has_bf16() else "openvino f32")
    monkeypatch.setattr("airline.network.openvino_cpu.has_bf16", lambda: False)
    assert OpenVinoNetwork("fast").name == "openvino f32"


@given(height=st.integers(1, 70), width=st.integers(1, 70), seed=st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_any_size_and_few_are_kept(height: int, width: int, seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width), np.uint8)
    assert_close(EXACT(image), TORCH(image), "f32")
    assert EXACT._request.cache_info().currsize <= SIZES


EXACT, TORCH = in_float32("fast"), TorchNetwork("fast")


@pytest.mark.parametrize(
    "spec", [UNetSpec((8, 16, 32), convs=2), UNetSpec((4,), unshuffle=1, smoothed=3), SPECS["default"]]
)
def test_every_shape_of_network(tmp_path: Path, spec: UNetSpec) -> None:
    torch.manual_seed(1)
    net = UNet(spec)
    assert {name: tuple(tensor.shape) for name, tensor in net.state_dict().items()} == spec.shapes()
    save_unet(net, tmp_path / "net.safetensors")
    image = np.random.default_rng(0).integers(0, 256, (50, 40), np.uint8)
    assert_close(in_float32(tmp_path / "net.safetensors")(image), TorchNetwork(net.eval())(image), "f32")


SIGNALS_AFTER_NETWORKS = """
import faulthandler, gc, signal, threading
from airline.network.openvino_cpu import OpenVinoNetwork

def drop_the_first():
    del networks[0]
    gc.collect()

faulthandler.enable()  # as tests and many robots do: signals then have a stack of their own
signal.signal(signal.SIGTERM, lambda *_: print("told", flush=True))
networks = [OpenVinoNetwork("fast"), OpenVinoNetwork("fast")]
drop_the_first()
drop_the_first()
signal.raise_signal(signal.SIGTERM)
networks = [OpenVinoNetwork("fast")]
thread = threading.Thread(target=drop_the_first)
thread.start()
thread.join()
signal.raise_signal(signal.SIGTERM)
"""


def test_signals_arrive_after_networks_have_gone() -> None:
    """A library's stack for signals must not go with one of its networks."""
    done = subprocess.run([sys.executable, "-c", SIGNALS_AFTER_NETWORKS], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, ["told", "told"]), done.stderr

"""The edge network in OpenVINO gives torch's edges."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.network.runtimes import has_bf16
from airline.network.spec import SPECS, UNetSpec
from airline.network.torch_runtimes import TorchNetwork
from airline.network.unet import UNet
from airline.network.weights import save_unet
from tests.helpers.pictures import assert_close, pictures

pytest.importorskip("openvino")
from airline.network.openvino_cpu import OpenVinoNetwork


def in_float32(weights: str | Path) -> OpenVinoNetwork:
    """As on a processor without bfloat16."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("airline.network.openvino_cpu.has_bf16", lambda: False)
        return OpenVinoNetwork(weights)


@pytest.mark.parametrize("weights", ["default", "fast", "accurate"])
def test_agrees_with_torch(scene: np.ndarray, weights: str) -> None:
    theirs = TorchNetwork(weights)
    for ours, precision in ((in_float32(weights), "f32"), (OpenVinoNetwork(weights), "bf16")):
        for image in (*pictures(scene), np.full((20, 30), 77, np.uint8)):
            assert_close(ours(image), theirs(image), precision)


def test_works_in_what_the_processor_is_made_for() -> None:
    assert OpenVinoNetwork("fast").name == ("openvino bf16" if has_bf16() else "openvino f32")
    assert in_float32("fast").name == "openvino f32"


@pytest.fixture(scope="module")
def networks() -> tuple[OpenVinoNetwork, TorchNetwork]:
    """Ours and theirs."""
    return in_float32("fast"), TorchNetwork("fast")


@given(height=st.integers(1, 70), width=st.integers(1, 70), seed=st.integers(0, 99))
@settings(max_examples=15)
def test_any_size(networks: tuple[OpenVinoNetwork, TorchNetwork], height: int, width: int, seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width), np.uint8)
    ours, theirs = (network(image) for network in networks)
    assert_close(ours, theirs, "f32")


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

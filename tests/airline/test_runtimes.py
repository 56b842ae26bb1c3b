"""The edge network gives the same edges in every runtime."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import openvino as ov
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from airline import AirLine
from airline.config import Runtime
from airline.errors import ConfigError, WeightsError
from airline.network.openvino_cpu import OpenVinoNetwork
from airline.network.processor import has_bf16, has_vnni, vector_instructions
from airline.network.runtimes import open_network
from airline.network.spec import SPECS, UNetSpec
from airline.network.torch_cpu import TorchNetwork
from airline.network.torch_cuda import CudaNetwork
from airline.network.unet import UNet
from airline.network.weights import save_unet
from airline.stages.edges import UNetEdges
from frontend.sources.scene import SceneSource

WITHIN = {"f32": (1e-4, 1e-6), "bf16": (0.06, 0.002), "int8": (0.2, 0.01)}  # largest and mean difference of edges
PRECISIONS = [("f32", "f32"), ("bf16", "bf16"), ("int8", "f32"), ("int8", "bf16")]  # and numbers of the other layers


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    image: np.ndarray = next(iter(SceneSource())).image[:, :, 1]
    return image


def in_precision(weights: str, precision: str = "f32", numbers: str = "f32") -> OpenVinoNetwork:
    network = OpenVinoNetwork(weights)
    network._precision, network._numbers = precision, getattr(ov.Type, numbers)
    return network


def assert_close(ours: np.ndarray, theirs: np.ndarray, precision: str) -> None:
    difference = np.abs(ours - theirs)
    assert ours.shape == theirs.shape
    assert ours.dtype == theirs.dtype == np.float32
    assert (difference.max() <= WITHIN[precision][0]) & (difference.mean() <= WITHIN[precision][1])


@pytest.mark.parametrize(("precision", "numbers"), PRECISIONS)
@pytest.mark.parametrize("weights", ["default", "fast", "accurate"])
def test_openvino_agrees_with_torch(scene: np.ndarray, weights: str, precision: str, numbers: str) -> None:
    if (numbers == "bf16" and not has_bf16()) or (precision == "int8" and not has_vnni()):
        pytest.skip("needs a processor that multiplies such numbers")
    ours, theirs = in_precision(weights, precision, numbers), TorchNetwork(weights)
    low_contrast = (195 + scene / 25).astype(np.uint8)
    dark16 = (scene.astype(np.uint16) // 4 + 20_000).astype(np.uint16)
    for image in (scene, scene[:240, 5:219], scene[::2, ::3], scene[:, ::-1], low_contrast, dark16):
        assert_close(ours(image), theirs(image), precision)


@pytest.mark.parametrize("weights", ["default", "fast", "accurate"])
def test_half_precision_of_torch_agrees(scene: np.ndarray, weights: str) -> None:
    """All that runs on a GPU, but for the graph."""
    ours, theirs = CudaNetwork(weights, "cpu", lambda network, image: lambda: network(image)), TorchNetwork(weights)
    dark16 = (scene.astype(np.uint16) // 4 + 20_000).astype(np.uint16)
    for image in (scene, scene[:240, 5:219], scene[:, ::-1], dark16, scene):
        assert_close(ours(image), theirs(image), "bf16")


def test_half_precision_leaves_the_given_network_alone() -> None:
    net = UNet(SPECS["fast"])
    CudaNetwork(net, "cpu", lambda network, image: lambda: network(image))
    assert {parameter.dtype for parameter in net.parameters()} == {torch.float32}


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_cuda_agrees_with_the_cpu_and_keeps_its_results(scene: np.ndarray) -> None:
    ours, theirs = CudaNetwork("default"), TorchNetwork("default")
    images = [np.ascontiguousarray(np.roll(scene, 40 * k, axis=1))[: 480 - 16 * k] for k in range(7)]
    for found, image in zip([ours(image) for image in images], images, strict=True):
        assert_close(found, theirs(image), "bf16")


@given(height=st.integers(1, 70), width=st.integers(1, 70), seed=st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_any_size(height: int, width: int, seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width), np.uint8)
    assert_close(EXACT(image), TORCH(image), "f32")


EXACT, TORCH = in_precision("fast"), TorchNetwork("fast")


@pytest.mark.parametrize(
    "spec", [UNetSpec((8, 16, 32), convs=2), UNetSpec((4,), unshuffle=1, smoothed=3), SPECS["default"]]
)
def test_every_shape_of_network(tmp_path: Path, spec: UNetSpec) -> None:
    torch.manual_seed(1)
    net = UNet(spec)
    assert {name: tuple(tensor.shape) for name, tensor in net.state_dict().items()} == spec.shapes()
    save_unet(net, tmp_path / "net.safetensors")
    image = np.random.default_rng(0).integers(0, 256, (50, 40), np.uint8)
    ours = in_precision(str(tmp_path / "net.safetensors"))
    assert_close(ours(image), TorchNetwork(net.eval())(image), "f32")


@pytest.mark.parametrize("spec", [UNetSpec((6, 12, 24), convs=2, smoothed=1), UNetSpec((4,)), SPECS["default"]])
def test_pixels_convolved_in_pairs_give_the_same(tmp_path: Path, spec: UNetSpec) -> None:
    torch.manual_seed(2)
    save_unet(UNet(spec), tmp_path / "net.safetensors")
    single, pairs = (in_precision(str(tmp_path / "net.safetensors")) for _ in range(2))
    single._in_pairs, pairs._in_pairs = lambda: False, lambda: True
    for shape in ((50, 42), (31, 97)):
        image = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
        np.testing.assert_allclose(pairs(image), single(image), atol=1e-5)


def test_lines_agree(scene: np.ndarray) -> None:
    """In 8-bit numbers they agree less closely: see `test_int8`."""
    detector = AirLine(runtime="openvino")
    detector.edges.network._precision = "bf16" if detector.edges.network._numbers == ov.Type.bf16 else "f32"
    ours, theirs = detector(scene), AirLine(runtime="torch")(scene)
    assert abs(len(ours) - len(theirs)) <= 0.03 * len(theirs)
    near = [np.abs(theirs.segments - segment).max(axis=(1, 2)).min() < 1 for segment in ours.segments]
    assert np.mean(near) > 0.9


@pytest.mark.parametrize("runtime", ["openvino", *([] if vector_instructions() is None else ["native"])])
def test_results_are_the_callers_own_and_threads_do_not_mix(scene: np.ndarray, runtime: Runtime) -> None:
    network = open_network("fast", runtime)
    images = [np.ascontiguousarray(np.roll(scene, 40 * k, axis=1)) for k in range(6)]
    alone = [network(image).copy() for image in images]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(network, images * 3))
    for result, expected in zip(together, alone * 3, strict=True):
        np.testing.assert_array_equal(result, expected)
    assert len({result.ctypes.data for result in together}) == len(together)


SIGNALS_AFTER_NETWORKS = """
import faulthandler, gc, signal, threading
from airline.network.openvino_cpu import OpenVinoNetwork
from airline.network.processor import has_bf16, has_vnni, vector_instructions

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


def test_few_sizes_are_kept() -> None:
    network = OpenVinoNetwork("fast")
    for side in range(16, 176, 16):
        network(np.zeros((side, side), np.uint8))
    assert len(network._sizes) == 4


def test_choice_of_runtime(tmp_path: Path) -> None:
    assert open_network("fast", "torch").name == "torch cpu f32"
    assert open_network("fast", "openvino").name.removeprefix("openvino ") in WITHIN
    assert open_network(UNet(SPECS["fast"]).eval()).name.startswith("torch")
    if not torch.cuda.is_available():
        best = "openvino" if vector_instructions() is None else "native"
        assert open_network("fast").name.startswith(best)
        with pytest.raises(ConfigError, match="no CUDA device"):
            open_network("fast", "cuda")
    with pytest.raises(ConfigError, match="from a file"):
        UNetEdges(UNet(SPECS["fast"]), "openvino")
    with pytest.raises(WeightsError, match="no weights file"):
        open_network(tmp_path / "missing.safetensors", "openvino")


def test_detecting_needs_no_torch() -> None:
    code = "import sys, numpy, airline; airline.AirLine(runtime='openvino')(numpy.zeros((64, 64), numpy.uint8)); "
    code += "sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

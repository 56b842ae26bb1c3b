"""Which runtime the edge network gets, and what holds for every one of them; torch in half precision."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch

from airline import AirLine
from airline.config import Runtime
from airline.errors import ConfigError, WeightsError
from airline.evaluation.metrics import pixel_scores
from airline.network import runtimes
from airline.network.runtimes import AVX2, AVX2_VNNI, AVX512_VNNI, Isa, has_bf16, open_network, vector_instructions
from airline.network.spec import SPECS
from airline.network.torch_runtimes import CudaNetwork, TorchNetwork
from airline.network.unet import UNet
from airline.network.weights import load_unet
from tests.helpers.pictures import assert_close, pictures

NATIVE: list[Runtime] = [] if vector_instructions() is None else ["native"]
RUNTIMES: list[Runtime] = [*NATIVE, *(["openvino"] if importlib.util.find_spec("openvino") else [])]
XEON = {"sse2", "avx2", "fma", "avx512vnni", "avx512bw", "avx512bf16", "amx-bf16"}


@pytest.mark.parametrize("weights", ["default", "fast", "accurate"])
def test_half_precision_of_torch_agrees(scene: np.ndarray, weights: str) -> None:
    """All that runs on a GPU, but for the graph."""
    net = load_unet(weights)
    ours, theirs = CudaNetwork(net, "cpu", lambda network, image: lambda: network(image)), TorchNetwork(weights)
    for image in (*pictures(scene), scene):
        assert_close(ours(image), theirs(image), "bf16")
    assert {parameter.dtype for parameter in net.parameters()} == {torch.float32}, "the given network is left alone"


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_cuda_agrees_with_the_cpu_and_keeps_its_results(scene: np.ndarray) -> None:
    ours, theirs = CudaNetwork("default"), TorchNetwork("default")
    images = [np.ascontiguousarray(np.roll(scene, 40 * k, axis=1))[: 480 - 16 * k] for k in range(7)]
    for found, image in zip([ours(image) for image in images], images, strict=True):
        assert_close(found, theirs(image), "bf16")


@pytest.mark.parametrize("runtime", RUNTIMES)
def test_finds_the_lines_that_torch_finds(scene: np.ndarray, runtime: Runtime) -> None:
    ours, theirs = AirLine(runtime=runtime)(scene), AirLine(runtime="torch")(scene)
    assert abs(len(ours) - len(theirs)) <= 0.03 * len(theirs)
    same = pixel_scores(ours.segments, theirs.segments, theirs.segments, scene.shape)
    assert min(same.p1, same.r1) > 0.97, "pixels of the lines within 1 px of the others'"


@pytest.mark.parametrize("runtime", RUNTIMES)
def test_results_are_the_callers_own_and_threads_do_not_mix(scene: np.ndarray, runtime: Runtime) -> None:
    network = open_network("fast", runtime)
    images = [np.ascontiguousarray(np.roll(scene, 40 * k, axis=1)) for k in range(6)]
    alone = [network(image).copy() for image in images]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(network, images * 3))
    for result, expected in zip(together, alone * 3, strict=True):
        np.testing.assert_array_equal(result, expected)
    assert len({result.ctypes.data for result in together}) == len(together)


@pytest.mark.parametrize("runtime", RUNTIMES)
def test_detecting_needs_no_torch(runtime: Runtime) -> None:
    others = {"torch", "openvino"} - {runtime}
    code = f"import sys, numpy, airline; airline.AirLine(runtime={runtime!r})(numpy.zeros((64, 64), numpy.uint8)); "
    code += f"sys.exit(bool({others!r} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_choice_of_runtime(tmp_path: Path) -> None:
    assert open_network("fast", "torch").name == "torch cpu f32"
    assert open_network(UNet(SPECS["fast"]).eval()).name.startswith("torch")
    for runtime in RUNTIMES:
        assert open_network("fast", runtime).name.startswith(runtime)
        with pytest.raises(ConfigError, match="from a file"):
            open_network(UNet(SPECS["fast"]), runtime)
        with pytest.raises(WeightsError, match="no weights file"):
            open_network(tmp_path / "missing.safetensors", runtime)
    if not torch.cuda.is_available():
        assert open_network("fast").name.startswith([*RUNTIMES, "torch"][0])
        with pytest.raises(ConfigError, match="no CUDA device"):
            open_network("fast", "cuda")


def test_without_openvino_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    monkeypatch.delitem(sys.modules, "airline.network.openvino_cpu", raising=False)
    with pytest.raises(ConfigError, match=r"openvino is not installed: pip install 'airline-frontend\[openvino\]'"):
        open_network("fast", "openvino")


@pytest.mark.parametrize(
    ("features", "limit", "bf16", "isa"),
    [
        (XEON, None, True, AVX512_VNNI),
        (XEON, "AVX2_VNNI", False, AVX2_VNNI),
        (XEON, "AVX512_CORE", False, AVX2),
        (XEON, "SSE41", False, None),
        ({"sse2", "avx2", "fma"}, None, False, AVX2),
        ({"neon"}, None, True, None),
    ],
)
def test_what_the_processor_has(
    monkeypatch: pytest.MonkeyPatch, features: set[str], limit: str | None, bf16: bool, isa: Isa | None
) -> None:
    monkeypatch.setattr(runtimes, "_has", lambda feature: feature in features)
    monkeypatch.delenv("ONEDNN_MAX_CPU_ISA", raising=False)
    if limit is not None:
        monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", limit)
    assert (has_bf16(), vector_instructions()) == (bf16, isa)

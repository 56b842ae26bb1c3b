"""The edge network in 8-bit numbers: where it runs, what it needs of a weights file, that it finds the same lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from airline import AirLine
from airline.config import Runtime
from airline.errors import WeightsError
from airline.evaluation.metrics import pixel_scores
from airline.network import openvino_cpu, processor
from airline.network.openvino_cpu import OpenVinoNetwork
from airline.network.runtimes import open_network
from airline.network.spec import SPECS, UNetSpec
from airline.network.torch_cpu import TorchNetwork
from airline.network.unet import UNet, normalise
from airline.network.weights import BUNDLED, load_ranges, load_unet, save_unet
from airline.training.ranges import BEYOND, _of_most, measure_ranges
from frontend.sources.scene import SceneSource

RUNTIMES: list[Runtime] = ["openvino", *([] if processor.vector_instructions() is None else ["native"])]
XEON = {"sse2", "avx512vnni", "avx512bf16", "amx-bf16"}


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    image: np.ndarray = next(iter(SceneSource())).image[:, :, 1]
    return image


def convolutions(spec: UNetSpec) -> set[str]:
    return {name.removesuffix(".weight") for name in spec.shapes() if name.endswith(".weight")}


@pytest.mark.parametrize("name", BUNDLED)
def test_bundled_weights_have_ranges(name: str) -> None:
    ranges = load_ranges(name)
    assert ranges.keys() == convolutions(load_unet(name).spec) - {"down.0.0"}
    assert all(low <= 0 < high for low, high in ranges.values())


def test_one_odd_image_does_not_widen_the_ranges() -> None:
    usual = np.ones(39)
    assert _of_most(-np.append(usual, 9), np.append(usual, 9)) == (-1, 1)
    assert _of_most(np.array([-2.0, 0]), np.array([3.0, 1])) == (-2, 3), "of a few, none is odd"


def test_ranges_hold_all_numbers_but_a_few(scene: np.ndarray) -> None:
    torch.manual_seed(3)
    net = UNet(UNetSpec((4, 8, 16), convs=2, unshuffle=1, smoothed=0)).eval()
    images = [scene, np.ascontiguousarray(scene[::2, ::2])]
    ranges = measure_ranges(net, images)
    assert ranges.keys() == convolutions(net.spec) - {"down.0.0"}
    with torch.no_grad():
        for image in images:
            first = net.down[0](normalise(torch.from_numpy(image.astype(np.float32))[None, None]))
            taken = torch.nn.functional.max_pool2d(first, 2)
            low, high = ranges["down.1.0"]
            beyond = taken > high * (1 + 1e-5)  # what is equal but for rounding is within
            assert beyond.float().mean() <= BEYOND
            assert low == 0, "what comes from a ReLU is never negative"
    assert ranges["up.0.0"][0] < 0, "what is added may be"


def test_ranges_are_kept_in_the_file(tmp_path: Path) -> None:
    net = UNet(UNetSpec((4, 8)))
    ranges = {name: (-1.25, 2.5) for name in convolutions(net.spec) - {"down.0.0"}}
    save_unet(net, tmp_path / "with.safetensors", ranges)
    save_unet(net, tmp_path / "without.safetensors")
    assert load_ranges(tmp_path / "with.safetensors") == ranges
    assert load_ranges(tmp_path / "without.safetensors") == {}


@pytest.mark.parametrize(
    "ranges",
    ["[1, 2]", '{"head": [0, 1]}', "no JSON", "[" * 100_000, '{"head": 1, "up.0.0": 1, "lateral.0": 1, "down.1.0": 1}']
    + [
        f'{{"head": [{pair}], "up.0.0": [0, 1], "lateral.0": [0, 1], "down.1.0": [0, 1]}}'
        for pair in ("NaN, 1", "2, 1", "0, 1e9", '"a", "b"', "0, 1, 2")
    ],
)
def test_ranges_that_are_none_are_refused(tmp_path: Path, ranges: str) -> None:
    path, spec = tmp_path / "net.safetensors", UNetSpec((4, 8))
    save_file(UNet(spec).state_dict(), path, metadata={**spec.to_metadata(), "ranges": ranges})
    with pytest.raises(WeightsError, match="does not hold weights of this edge network"):
        OpenVinoNetwork(path)


def test_maps_of_zeros_have_ranges_that_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    monkeypatch.setattr(openvino_cpu, "has_bf16", lambda: False)
    monkeypatch.setattr(openvino_cpu, "has_vnni", lambda: True)
    theirs = TorchNetwork(net)(image)
    for runtime in RUNTIMES:
        ours = open_network(tmp_path / "net.safetensors", runtime)
        assert ours.name == f"{runtime} int8"
        np.testing.assert_allclose(ours(image), theirs, atol=1e-3)


def test_where_it_is_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    save_unet(UNet(UNetSpec((4, 8))), tmp_path / "without.safetensors")
    for bf16, vnni, weights, expected in (
        (False, True, "fast", {"int8"}),
        (True, True, "fast", {"int8"}),
        (False, False, "fast", {"f32"}),
        (True, False, "fast", {"bf16", "f32"}),  # if OpenVINO agrees
        (False, True, str(tmp_path / "without.safetensors"), {"f32"}),
    ):
        monkeypatch.setattr(openvino_cpu, "has_bf16", lambda bf16=bf16: bf16)
        monkeypatch.setattr(openvino_cpu, "has_vnni", lambda vnni=vnni: vnni)
        assert OpenVinoNetwork(weights).name.split()[-1] in expected


@pytest.mark.parametrize(
    ("features", "limit", "amx", "bf16", "vnni"),
    [
        (XEON, None, True, True, True),
        (XEON, "avx512_core_amx", True, True, True),
        (XEON, "AVX512_CORE_BF16", False, True, True),
        (XEON, "AVX2_VNNI", False, False, True),
        (XEON, "AVX512_CORE", False, False, False),
        ({"sse2", "avxvnni"}, "DEFAULT", False, False, True),
        ({"sse2", "avx2"}, None, False, False, False),
        ({"neon"}, None, False, True, False),
    ],
)
def test_what_the_processor_has(
    monkeypatch: pytest.MonkeyPatch, features: set[str], limit: str | None, amx: bool, bf16: bool, vnni: bool
) -> None:
    monkeypatch.setattr(processor, "_has", lambda feature: feature in features)
    monkeypatch.delenv("ONEDNN_MAX_CPU_ISA", raising=False)
    if limit is not None:
        monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", limit)
    assert (processor.has_amx(), processor.has_bf16(), processor.has_vnni()) == (amx, bf16, vnni)


@pytest.mark.parametrize("amx", [False, True])
def test_convolutions_take_8_bit_numbers_and_find_the_same_lines(
    monkeypatch: pytest.MonkeyPatch, scene: np.ndarray, amx: bool
) -> None:
    if amx and not processor.has_bf16():
        pytest.skip("needs a processor that multiplies bfloat16 numbers")
    theirs = AirLine(runtime="torch")(scene)
    monkeypatch.setattr(openvino_cpu, "has_amx", lambda: amx)
    monkeypatch.setattr(openvino_cpu, "has_bf16", lambda: amx)
    monkeypatch.setattr(openvino_cpu, "has_vnni", lambda: True)
    detector = AirLine(runtime="openvino")
    ours = detector(scene)
    assert abs(len(ours) - len(theirs)) <= 0.03 * len(theirs)
    same = pixel_scores(ours.segments, theirs.segments, theirs.segments, scene.shape)
    assert min(same.p1, same.r1) > 0.97, "pixels of the lines within 1 px of the others'"
    request = detector.edges.network._sizes.of(240, 320).request
    layers = [node.get_rt_info() for node in request.get_compiled_model().get_runtime_model().get_ops()]
    narrow = [info["runtimePrecision"] for info in layers if info["layerType"] == "Convolution"]
    assert sum(precision in ("u8", "i8") for precision in narrow) == len(convolutions(SPECS["default"])) - 1

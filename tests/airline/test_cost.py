"""What the detector's cost is said to be."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
import torch

from airline.evaluation.cost import layer_costs, main
from airline.network.spec import SPECS
from airline.network.unet import UNet


@pytest.mark.parametrize("name", ["default", "fast", "accurate", "paper"])
def test_multiplications_are_those_of_the_convolutions_that_run(name: str) -> None:
    spec = SPECS[name]
    net = UNet(spec)
    counted = {"products": 0, "numbers": 0}

    def count(layer: torch.nn.Conv2d, inputs: tuple[torch.Tensor], output: torch.Tensor) -> None:
        counted["products"] += output.numel() * layer.weight[0].numel()
        counted["numbers"] += inputs[0].numel() + output.numel()

    for layer in net.modules():
        if isinstance(layer, torch.nn.Conv2d):
            layer.register_forward_hook(count)
    with torch.inference_mode():
        net(torch.zeros(1, 1, 2 * spec.stride, 3 * spec.stride))
    assert layer_costs(spec, 2 * spec.stride, 3 * spec.stride) == (counted["products"], counted["numbers"])


def test_picture_and_figures(clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pictures = [str(path) for path in sorted(clip.iterdir())[:2]]
    out = tmp_path / "cost.png"
    assert main([*pictures, "--out", str(out), "--size", "160x120", "640x480", "--rounds", "1"]) == 0
    assert cv2.imread(str(out)).shape[0] > 300
    printed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in printed[1:3]] == ["160x120", "640x480"]
    assert "0.49 GMAC" in printed[4]


@pytest.mark.parametrize(
    ("flags", "hint"), [(["--out", "a.jpg"], ".png"), (["--out", "a.png", "--rounds", "0"], "--rounds")]
)
def test_errors(flags: list[str], hint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(flags) == 2
    assert hint in capsys.readouterr().err

"""The edge network: a small U-Net that works at half resolution inside and answers at full resolution."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from airline.network.spec import UNetSpec
from airline.network.weights import Ranges

BEYOND = 1e-5  # share of an image's numbers that may lie beyond a range, on either side,
IMAGES = 0.95  # in so many of the images: one odd image must not take the others' precision


class UNet(nn.Module):
    """U-Net (Ronneberger et al. 2015) with additive skips, from a normalised grey image to edge logits.

    Activations at full resolution decide the time on a CPU; so the image is folded into channels first (pixel
    unshuffle) and the logits are unfolded at the end.
    """

    def __init__(self, spec: UNetSpec, norm: bool = False) -> None:
        """Build the network; `norm` adds batch normalisation after each 3x3 convolution, for training."""
        super().__init__()
        self.spec = spec
        widths = spec.widths
        inputs = [spec.unshuffle**2 + spec.smoothed, *widths]
        self.down = nn.ModuleList(
            _block(inputs[level], widths[level], spec.convs, norm) for level in range(spec.levels)
        )
        finer_first = range(spec.levels - 1)
        self.lateral = nn.ModuleList(nn.Conv2d(widths[level + 1], widths[level], 1) for level in finer_first)
        self.up = nn.ModuleList(_block(widths[level], widths[level], spec.convs, norm) for level in finer_first)
        self.head = nn.Conv2d(widths[0], spec.unshuffle**2, 1)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """(B, 1, H, W) edge logits of (B, 1, H, W) normalised float images; H and W are multiples of `spec.stride`."""
        x = nn.functional.pixel_unshuffle(image, self.spec.unshuffle)
        x = torch.cat([x, *self._smoothed(x)], dim=1)
        skips = []
        for level, block in enumerate(self.down):
            x = block(x if level == 0 else nn.functional.max_pool2d(x, 2))
            skips.append(x)
        for level in reversed(range(self.spec.levels - 1)):
            x = nn.functional.interpolate(self.lateral[level](x), scale_factor=2.0, mode="nearest")
            x = self.up[level](x + skips[level])
        return nn.functional.pixel_shuffle(self.head(x), self.spec.unshuffle)

    def _smoothed(self, x: torch.Tensor) -> list[torch.Tensor]:
        """(B, 1, h, w) copies of the mean channel, amplified as smoothing takes their contrast away."""
        copies = [x.mean(dim=1, keepdim=True)]
        for level in range(self.spec.smoothed):
            radius = level + 1
            copies.append(nn.functional.avg_pool2d(copies[-1], 2 * radius + 1, 1, radius, count_include_pad=False))
        return [2 * copy for copy in copies[1:]]

    def answer(self, gray: torch.Tensor) -> torch.Tensor:
        """(B, 1, H, W) edge logits, of the weights' kind, of (B, 1, H, W) float32 grey levels of any range and size."""
        height, width = gray.shape[2:]
        beyond = (0, -width % self.spec.stride, 0, -height % self.spec.stride)
        padded = nn.functional.pad(normalise(gray), beyond, mode="replicate")
        logits: torch.Tensor = self(padded.to(self.head.weight.dtype, memory_format=torch.channels_last))
        return logits[..., :height, :width]

    def folded(self) -> UNet:
        """A copy for inference, with batch normalisation folded into the convolutions."""
        plain = UNet(self.spec)
        for mine, other in zip(self._blocks(), plain._blocks(), strict=True):
            convs = [m for m in mine if isinstance(m, nn.Conv2d)]
            norms = [m for m in mine if isinstance(m, nn.BatchNorm2d)]
            targets = [m for m in other if isinstance(m, nn.Conv2d)]
            for index, target in enumerate(targets):
                conv = fuse_conv_bn_eval(convs[index].eval(), norms[index].eval()) if norms else convs[index]
                target.load_state_dict(conv.state_dict())
        for name in ("lateral", "head"):
            getattr(plain, name).load_state_dict(getattr(self, name).state_dict())
        return plain.eval()

    def _blocks(self) -> list[nn.Sequential]:
        return [block for group in (self.down, self.up) for block in group if isinstance(block, nn.Sequential)]


def normalise(images: torch.Tensor) -> torch.Tensor:
    """Zero mean and unit variance per image, (B, 1, H, W); a flat image becomes zeros."""
    std, mean = torch.std_mean(images, dim=(1, 2, 3), keepdim=True, correction=0)
    return (images - mean) / std.clamp(min=1.0)


def _block(inputs: int, outputs: int, convs: int, norm: bool) -> nn.Sequential:
    layers: list[nn.Module] = []
    for index in range(convs):
        layers.append(nn.Conv2d(inputs if index == 0 else outputs, outputs, 3, padding=1))
        if norm:
            layers.append(nn.BatchNorm2d(outputs))
        layers.append(nn.ReLU(inplace=True))
    return nn.Sequential(*layers)


def measure_ranges(net: UNet, images: Iterable[NDArray[np.uint8]]) -> Ranges:
    """Least and largest input of each convolution but the first, by its name, over most of some (H, W) uint8 images.

    Inference in 8-bit numbers must know them. `net` has its normalisation folded.
    """
    found: dict[str, list[tuple[float, float]]] = {}

    def note(name: str, values: torch.Tensor) -> None:
        numbers = values.flatten().numpy()
        rank = int(BEYOND * len(numbers))
        ordered = np.partition(numbers, (rank, len(numbers) - 1 - rank))
        found.setdefault(name, []).append((float(ordered[rank]), float(ordered[len(numbers) - 1 - rank])))

    convs = {name: part for name, part in net.named_modules() if isinstance(part, nn.Conv2d) and name != "down.0.0"}
    hooks = [
        conv.register_forward_pre_hook(lambda _, inputs, name=name: note(name, inputs[0]))
        for name, conv in convs.items()
    ]
    try:
        with torch.inference_mode():
            for image in images:
                net.answer(torch.from_numpy(image.astype(np.float32))[None, None])
    finally:
        for hook in hooks:
            hook.remove()
    return {name: _of_most(*np.array(each).T) for name, each in found.items()}


def _of_most(lows: NDArray[np.float64], highs: NDArray[np.float64]) -> tuple[float, float]:
    return float(np.quantile(lows, 1 - IMAGES, method="lower")), float(np.quantile(highs, IMAGES, method="higher"))

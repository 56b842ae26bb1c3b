"""Shape of the edge network."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Annotated

import msgspec
from msgspec import Meta

Size = Annotated[int, Meta(ge=1, le=1024)]
SIZES = 4  # of images for which a runtime keeps what it has ready


@dataclass(frozen=True)
class UNetSpec:
    """Shape of the network.

    Attributes:
        widths: channels per level, finest first; each level has half the resolution of the one before.
        convs: 3x3 convolutions per block.
        unshuffle: side of the pixel blocks that are folded into channels before the first level (1: none).
        smoothed: ever smoother copies of the image that join the first level's input, so that it sees past noise.
    """

    widths: Annotated[tuple[Size, ...], Meta(min_length=1, max_length=8)] = (16, 16, 32, 64, 64)
    convs: Size = 1
    unshuffle: Size = 2
    smoothed: Annotated[int, Meta(ge=0, le=8)] = 2

    @property
    def levels(self) -> int:
        """Number of resolutions; the coarsest is `unshuffle * 2 ** (levels - 1)` times smaller than the image."""
        return len(self.widths)

    @property
    def stride(self) -> int:
        """Image sides must be multiples of this."""
        return int(self.unshuffle * 2 ** (self.levels - 1))

    def folded_size(self, height: int, width: int) -> tuple[int, int]:
        """Rows and columns of the first level for an image of a size, filled up to the stride."""
        rows, columns = (-(-side // self.stride) * self.stride // self.unshuffle for side in (height, width))
        return rows, columns

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of every tensor of the network, by its name."""
        widths = self.widths
        inputs = [self.unshuffle**2 + self.smoothed, *widths]
        kernels: dict[str, tuple[int, int, int]] = {"head": (self.unshuffle**2, widths[0], 1)}
        for level in range(self.levels):
            kernels |= {f"down.{level}.{2 * k}": (widths[level], widths[level], 3) for k in range(self.convs)}
            kernels[f"down.{level}.0"] = (widths[level], inputs[level], 3)
        for level in range(self.levels - 1):
            kernels[f"lateral.{level}"] = (widths[level], widths[level + 1], 1)
            kernels |= {f"up.{level}.{2 * k}": (widths[level], widths[level], 3) for k in range(self.convs)}
        shapes: dict[str, tuple[int, ...]] = {}
        for name, (outputs, taken, side) in kernels.items():
            shapes |= {f"{name}.weight": (outputs, taken, side, side), f"{name}.bias": (outputs,)}
        return shapes

    def to_metadata(self) -> dict[str, str]:
        """The shape as the strings that a safetensors header can hold."""
        return {key: json.dumps(value) for key, value in asdict(self).items()}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> UNetSpec:
        """The shape that a header tells; raises KeyError, ValueError, RecursionError and msgspec.ValidationError."""
        return msgspec.convert({field.name: json.loads(metadata[field.name]) for field in fields(cls)}, cls)


SPECS = {
    "default": UNetSpec(),  # 121 K parameters
    "fast": UNetSpec((8, 16, 32, 64), smoothed=0),  # 39 K parameters, half the multiplications
    "accurate": UNetSpec((16, 32, 64, 64, 64)),  # 194 K parameters, twice the multiplications
    # the paper's, with our skips: 26 M parameters
    "paper": UNetSpec((64, 128, 256, 512, 1024), convs=2, unshuffle=1, smoothed=0),
}

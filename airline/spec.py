"""Shape of the edge network."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class UNetSpec:
    """Shape of the network.

    Attributes:
        base: channels of the first level; each further level doubles them.
        max_channels: no level has more channels than this.
        levels: number of resolutions; the coarsest is `unshuffle * 2 ** (levels - 1)` times smaller than the image.
        convs: 3x3 convolutions per block.
        unshuffle: side of the pixel blocks that are folded into channels before the first level (1: none).
        smoothed: ever smoother copies of the image at the first level's resolution that join its input: they cost next
            to nothing, and let a small network see past noise.
    """

    base: int = 16
    max_channels: int = 64
    levels: int = 5
    convs: int = 1
    unshuffle: int = 2
    smoothed: int = 2

    @property
    def stride(self) -> int:
        """Image sides must be multiples of this."""
        return int(self.unshuffle * 2 ** (self.levels - 1))

    @property
    def widths(self) -> list[int]:
        """Channels per level, finest first."""
        return [min(self.base * 2**level, self.max_channels) for level in range(self.levels)]

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
        return {key: str(value) for key, value in asdict(self).items()}


SPECS = {
    "default": UNetSpec(),  # 194 K parameters
    "fast": UNetSpec(base=8, levels=4, smoothed=0),  # 39 K parameters, about half the time
    # the paper's, with our skips: 26 M parameters
    "paper": UNetSpec(base=64, max_channels=1024, levels=5, convs=2, unshuffle=1, smoothed=0),
}

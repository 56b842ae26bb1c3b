"""Settings of the detector, their checks, its presets, and the names of what its network can run in."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from airline.errors import ConfigError

Preset = Literal["default", "fast", "accurate", "paper"]
PRESETS: tuple[str, ...] = get_args(Preset)
Runtime = Literal["auto", "native", "openvino", "torch", "cuda"]
RUNTIMES: tuple[str, ...] = get_args(Runtime)
Share = Annotated[float, Meta(ge=0, le=1)]
Pixels = Annotated[float, Meta(ge=0, le=1000)]


class _Checked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Raises ConfigError also where it is made in Python, whose arguments msgspec does not check."""

    def __post_init__(self) -> None:
        for field in msgspec.structs.fields(self):
            value = getattr(self, field.name)
            try:  # numpy's float64 is a float, but msgspec wants Python's own
                msgspec.convert(float(value) if isinstance(value, float) else value, field.type)
            except msgspec.ValidationError as error:
                raise ConfigError(f"setting {field.name}: {error}") from None


class EdgeConfig(_Checked, frozen=True, kw_only=True):
    """Stage 1 and the choice of edge pixels.

    Attributes:
        detector: "unet" or "canny".
        weights: bundled weights by name, or a file, for the U-Net.
        thin: work on the sub-pixel ridge of the edge map; otherwise on every pixel above the threshold.
        threshold: edge pixels have at least this probability.
        smoothing: side of the Gaussian window before thinning, odd, px; "auto" is 1 (none) for the U-Net, whose ridges
            are smooth, and 3 for any other edges.
        seed_threshold: and a region starts only at pixels of at least this one.
    """

    detector: Literal["unet", "canny"] = "unet"
    weights: str = "default"
    thin: bool = True
    smoothing: Literal["auto"] | Annotated[int, Meta(ge=1, le=31)] = "auto"
    threshold: Share = 0.15
    seed_threshold: Share = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.smoothing != "auto" and self.smoothing % 2 == 0:
            raise ConfigError("edge smoothing must be an odd number of pixels")


class OrientationConfig(_Checked, frozen=True, kw_only=True):
    """Stage 2.

    Attributes:
        kind: "lines" for kernels (`LineKernelOrientation`), "gradient" for the image's gradient, which needs no more.
        channels: number of kernels.
        kernel_size: side of the kernels, odd, px.
        subtract_mean: take the mean over the channels away before normalising, as the paper's released code does.
    """

    kind: Literal["lines", "gradient"] = "lines"
    channels: Annotated[int, Meta(ge=2, le=64)] = 6
    kernel_size: Annotated[int, Meta(ge=3, le=63)] = 5
    subtract_mean: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kernel_size % 2 == 0:
            raise ConfigError("orientation needs an odd kernel size")


class GrowConfig(_Checked, frozen=True, kw_only=True):
    """Stage 3.

    Attributes:
        similarity: T; a pixel joins a region if its descriptor agrees with the region's by at least this.
        min_pixels: m; regions with fewer pixels are dropped.
    """

    similarity: Share = 0.6
    min_pixels: Annotated[int, Meta(ge=1)] = 6


class FitConfig(_Checked, frozen=True, kw_only=True):
    """Stage 4.

    Attributes:
        kind: "total-least-squares", or "paper" for its voting, which needs no more.
        min_length: shorter lines are dropped, px.
        max_deviation: a region may leave its chord by this much, px.
        max_gap: collinear lines that end within this distance of each other are joined, px; 0 joins none.
        max_offset: joined lines may miss each other's axis by this much at the gap, px.
        max_angle: and differ in direction by this much, degrees.
        max_reach: end points move on along the edge by at most this much, px, and a quarter of the line's length.
        min_score: lines with a lower score are dropped.
    """

    kind: Literal["total-least-squares", "paper"] = "total-least-squares"
    min_length: Pixels = 8.0
    max_deviation: Annotated[float, Meta(gt=0, le=1000)] = 2.5
    max_gap: Pixels = 5.0
    max_offset: Pixels = 1.0
    max_angle: Annotated[float, Meta(ge=0, le=90)] = 8.0
    max_reach: Pixels = 14.0
    min_score: Share = 0.15


class RefineConfig(_Checked, frozen=True, kw_only=True):
    """Stage 5.

    Attributes:
        max_shift: a line of which an end point would move by more than this stays where it is, px; 0 moves none.
    """

    max_shift: Share = 0.5


class DetectorConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All settings of the detector."""

    edges: EdgeConfig = EdgeConfig()
    orientation: OrientationConfig = OrientationConfig()
    grow: GrowConfig = GrowConfig()
    fit: FitConfig = FitConfig()
    refine: RefineConfig = RefineConfig()


_PRESETS = {
    "default": DetectorConfig(),
    "fast": DetectorConfig(edges=EdgeConfig(weights="fast")),
    "accurate": DetectorConfig(edges=EdgeConfig(weights="accurate")),
    "paper": DetectorConfig(
        edges=EdgeConfig(thin=False, threshold=0.3, seed_threshold=0.3),
        orientation=OrientationConfig(kernel_size=9),
        grow=GrowConfig(similarity=0.8, min_pixels=15),
        fit=FitConfig(kind="paper"),
        refine=RefineConfig(max_shift=0),
    ),
}


def preset(name: str) -> DetectorConfig:
    """Settings by name: "default", "fast" and "accurate" for a smaller and a larger network, or "paper" for the paper's
    scheme, repaired as docs/detector.md says; raises ConfigError for any other.
    """
    if name not in _PRESETS:
        raise ConfigError(f"no preset named '{name}': use one of {', '.join(PRESETS)}")
    return _PRESETS[name]

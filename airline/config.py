"""Settings of the detector, its presets, and the names of what its network can run in."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec

from airline.errors import ConfigError

Preset = Literal["default", "fast", "accurate", "paper"]
PRESETS: tuple[str, ...] = get_args(Preset)
Runtime = Literal["auto", "native", "openvino", "torch", "cuda"]
RUNTIMES: tuple[str, ...] = get_args(Runtime)
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Pixels = Annotated[float, msgspec.Meta(ge=0, le=1000)]


class EdgeConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
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
    smoothing: Literal["auto"] | Annotated[int, msgspec.Meta(ge=1, le=31)] = "auto"
    threshold: Share = 0.15
    seed_threshold: Share = 0.3


class OrientationConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Stage 2; see `LineKernelOrientation` and, for "gradient", `GradientOrientation`."""

    kind: Literal["lines", "gradient"] = "lines"
    channels: Annotated[int, msgspec.Meta(ge=2, le=64)] = 6
    kernel_size: Annotated[int, msgspec.Meta(ge=3, le=63)] = 5
    subtract_mean: bool = True


class GrowConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Stage 3; see `RegionGrower`."""

    similarity: Share = 0.6
    min_pixels: Annotated[int, msgspec.Meta(ge=1)] = 6


class FitConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Stage 4; see `TotalLeastSquaresFitter` and, for "paper", `PaperFitter`."""

    kind: Literal["total-least-squares", "paper"] = "total-least-squares"
    min_length: Pixels = 8.0
    max_deviation: Pixels = 2.5
    max_gap: Pixels = 5.0
    max_offset: Pixels = 1.0
    max_angle: Annotated[float, msgspec.Meta(ge=0, le=90)] = 8.0
    max_reach: Pixels = 14.0
    min_score: Share = 0.15


class RefineConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Stage 5; see `ImageRefiner`. A `max_shift` of 0 leaves lines where the edge map has them."""

    max_shift: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.5


class DetectorConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All settings of the detector."""

    edges: EdgeConfig = EdgeConfig()
    orientation: OrientationConfig = OrientationConfig()
    grow: GrowConfig = GrowConfig()
    fit: FitConfig = FitConfig()
    refine: RefineConfig = RefineConfig()


def preset(name: str) -> DetectorConfig:
    """Settings by name: "default", "fast" and "accurate" for a smaller and a larger network, or "paper" for the paper's
    scheme, repaired as docs/detector.md says.

    Raises:
        ConfigError: no such preset.
    """
    if name == "default":
        return DetectorConfig()
    if name in ("fast", "accurate"):
        return DetectorConfig(edges=EdgeConfig(weights=name))
    if name == "paper":
        return DetectorConfig(
            edges=EdgeConfig(thin=False, threshold=0.3, seed_threshold=0.3),
            orientation=OrientationConfig(kernel_size=9),
            grow=GrowConfig(similarity=0.8, min_pixels=15),
            fit=FitConfig(kind="paper"),
            refine=RefineConfig(max_shift=0),
        )
    raise ConfigError(f"no preset named '{name}': use one of {', '.join(PRESETS)}")

"""All settings of a run: presets, TOML files, and their checks."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from airline.config import DetectorConfig, Preset, Runtime, preset
from airline.errors import ConfigError, InputError
from frontend.tracking.config import TrackerConfig


class InputConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which frames of the input are used.

    Attributes:
        start, end: seconds since the first frame.
        stride: every how many frames one is used.
        max_frames: at most this many frames are used.
        resize: "WIDTHxHEIGHT", or "WIDTH" to keep the aspect.
        fps: frame rate of folders without timestamps.
        realtime: whether a recording is played at the pace of its stamps, like a live source, which it counts as then.
        max_latency: seconds that a frame of a live source may wait before it is dropped; other sources drop none.
        reconnect: seconds for which a network stream that drops is tried again; 0 takes its end as the end.
        topic: image topic of a log.
        time_source: where a log's times come from: the messages' headers, their publish time or the log's clock.
        calib: file with the camera's calibration.
        undistort: whether lens distortion is removed before detection.
    """

    start: Annotated[float, Meta(ge=0)] | None = None
    end: Annotated[float, Meta(gt=0)] | None = None
    stride: Annotated[int, Meta(ge=1)] = 1
    max_frames: Annotated[int, Meta(ge=1)] | None = None
    resize: str | None = None
    fps: Annotated[float, Meta(gt=0)] = 30.0
    realtime: bool = False
    max_latency: Annotated[float, Meta(gt=0)] = 0.2
    reconnect: Annotated[float, Meta(ge=0)] = 60.0
    topic: str | None = None
    time_source: Literal["header", "publish", "log"] = "header"
    calib: str | None = None
    undistort: bool = False

    def __post_init__(self) -> None:
        start = self.start or 0.0
        if self.end is not None and self.end <= start:
            raise ConfigError(f"end must be later than start, and {self.end:g} s is not later than {start:g} s")
        _ = self.size

    @property
    def size(self) -> tuple[int, int | None] | None:
        """`resize` as (width, height), px; height is None to keep the aspect."""
        return None if self.resize is None else parse_size(self.resize)


class RecordingConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What goes into the Rerun recording.

    Attributes:
        image: how the camera's image is logged; "video" logs the input file once, without the detector's stages.
        jpeg_quality: of pictures, 1 to 100.
        every: every so many frames one is logged.
        descriptor_every: the float descriptor map is logged every so many frames; 0 never.
        blueprint: how the viewer lays it out.
    """

    image: Literal["jpeg", "raw", "video", "none"] = "jpeg"
    jpeg_quality: Annotated[int, Meta(ge=1, le=100)] = 80
    every: Annotated[int, Meta(ge=1)] = 1
    descriptor_every: Annotated[int, Meta(ge=0)] = 30
    blueprint: Literal["minimal", "full"] = "full"


class RunConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everything that decides the result of a run."""

    preset: Preset = "default"
    runtime: Runtime = "auto"
    serial: bool = False  # one thing after the other in one thread; the results are the same
    input: InputConfig = InputConfig()
    detector: DetectorConfig = DetectorConfig()
    tracker: TrackerConfig = TrackerConfig()
    recording: RecordingConfig = RecordingConfig()


def parse_size(text: str) -> tuple[int, int | None]:
    """(width, height), px, of "WIDTHxHEIGHT"; the height of "WIDTH" is None. Raises ConfigError for anything else."""
    width, separator, height = text.lower().partition("x")
    try:
        return int(width), int(height) if separator else None
    except ValueError:
        raise ConfigError(f"cannot resize to '{text}': give WIDTHxHEIGHT or WIDTH, px, e.g. 640x480") from None


def load(path: Path | None, flags: dict[str, Any]) -> RunConfig:
    """Settings from a preset, a TOML file over it and flags over both.

    Args:
        path: TOML file; it may name any part of the settings, the rest keeps the preset's values.
        flags: nested settings from the command line.

    Raises:
        InputError: the file cannot be read.
        ConfigError: a setting is unknown, of the wrong type or out of range.
    """
    stored: dict[str, Any] = {}
    if path is not None:
        try:
            stored = tomllib.loads(path.read_text(encoding="utf-8"), parse_float=_finite)
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot read the settings file {path} ({error}): give a TOML file") from None
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{path} is not valid TOML ({error}): write a fresh one with --dump-config") from None
    chosen = _merge(stored, flags)
    name = chosen.get("preset", "default")
    base = {"detector": msgspec.to_builtins(preset(str(name)))}
    try:
        return msgspec.convert(_merge(base, chosen), RunConfig)
    except msgspec.ValidationError as error:
        what, _, where = str(error).partition(" - at `$.")
        raise ConfigError(f"setting {where.rstrip('`')}: {what}; --dump-config prints all settings") from None


def dump(config: RunConfig) -> str:
    """The settings as TOML that `load` reads back; settings without a value are left out."""
    import tomli_w

    return tomli_w.dumps(_without_none(msgspec.to_builtins(config)))


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ConfigError(f"settings must be finite numbers, not {text}")
    return float(text)


def _merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """`over` laid over `base`, tables into tables."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = _merge(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return merged


def _without_none(values: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _without_none(value) if isinstance(value, dict) else value
        for key, value in values.items()
        if value is not None
    }

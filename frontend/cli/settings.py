"""All settings of a run, their meaning and their checks; presets and TOML files."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from airline.config import DetectorConfig, Preset, Runtime, preset
from airline.errors import ConfigError, InputError
from frontend.tracking.config import TrackerConfig

NO_CALIBRATION = "none"


class InputConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which frames of the input are used, and with which camera."""

    start: Annotated[float, Meta(ge=0, description="skip the first S seconds")] | None = None
    end: Annotated[float, Meta(gt=0, description="stop S seconds after the first frame")] | None = None
    stride: Annotated[int, Meta(ge=1, description="use every N-th frame")] = 1
    max_frames: Annotated[int, Meta(ge=1, description="stop after N frames")] | None = None
    resize: Annotated[str, Meta(description="resize frames, e.g. 640x480, or 640 to keep the aspect")] | None = None
    fps: Annotated[float, Meta(gt=0, description="frame rate of image folders without timestamps")] = 30.0
    realtime: Annotated[bool, Meta(description="play a recording at its own pace, as a camera would")] = False
    max_latency: Annotated[float, Meta(gt=0, description="drop a live source's frames that have waited longer")] = 0.2
    reconnect: Annotated[float, Meta(ge=0, description="try a stream that drops again for S seconds")] = 60.0
    no_autorotate: Annotated[bool, Meta(description="leave pictures as they are stored, on their side")] = False
    topic: Annotated[str, Meta(description="image topic")] | None = None
    time_source: Annotated[Literal["header", "publish", "log"], Meta(description="where times come from")] = "header"
    calib: Annotated[str, Meta(description="calibration file, or none (default: the input's)")] | None = None
    undistort: Annotated[bool, Meta(description="remove lens distortion before detection")] = False
    stereo: Annotated[bool, Meta(description="take the right camera, too, that lies beside the left one")] = False
    right: Annotated[str, Meta(description="the right camera: a folder, a video, a log, ...")] | None = None
    right_topic: Annotated[str, Meta(description="its image topic")] | None = None
    right_calib: (
        Annotated[str, Meta(description="its calibration file (default: --calib's, if that is of both)")] | None
    ) = None
    side_by_side: Annotated[bool, Meta(description="a picture holds both cameras' images, the left one first")] = False
    rectified: Annotated[bool, Meta(description="both images have the same rows already, and no lens")] = False
    max_stereo_gap: (
        Annotated[float, Meta(ge=0, description="times of a pair may be S seconds apart (default: a third of a frame)")]
        | None
    ) = None

    def __post_init__(self) -> None:
        start = self.start or 0.0
        if self.end is not None and self.end <= start:
            raise ConfigError(f"end must be later than start, and {self.end:g} s is not later than {start:g} s")
        _ = self.size
        two = self.right is not None or self.right_topic is not None
        if self.side_by_side and (two or self.max_stereo_gap is not None):
            raise ConfigError(
                "with --side-by-side one picture has both images, of one time: leave --right, --right-topic and "
                "--max-stereo-gap out"
            )
        if not self.pairs and (self.right_calib is not None or self.rectified or self.max_stereo_gap is not None):
            raise ConfigError(
                "--right-calib, --rectified and --max-stereo-gap are for pairs: give --stereo, --right RIGHT or "
                "--side-by-side, too"
            )
        if self.right_calib is not None and self.calib_file is None:
            raise ConfigError("--right-calib gives the right camera's calibration: give the left one's with --calib")

    @property
    def pairs(self) -> bool:
        """Whether frames are pairs."""
        return self.stereo or self.side_by_side or self.right is not None or self.right_topic is not None

    @property
    def calib_file(self) -> str | None:
        """`calib` where it names a file."""
        return None if self.calib == NO_CALIBRATION else self.calib

    @property
    def size(self) -> tuple[int, int | None] | None:
        """`resize` as (width, height), px; height is None to keep the aspect. Raises ConfigError where it is none."""
        if self.resize is None:
            return None
        width, separator, height = self.resize.lower().partition("x")
        try:
            return int(width), int(height) if separator else None
        except ValueError:
            raise ConfigError(
                f"cannot resize to '{self.resize}': give WIDTHxHEIGHT or WIDTH, px, e.g. 640x480"
            ) from None


class RecordingConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What goes into the Rerun recording."""

    image: Annotated[
        Literal["jpeg", "raw", "video", "none"],
        Meta(description="how images are recorded; video: the input's own as it is, and no stages of the detector"),
    ] = "jpeg"
    jpeg_quality: Annotated[int, Meta(ge=1, le=100, description="of all pictures, 1 to 100")] = 80
    every: Annotated[int, Meta(ge=1, description="record every N-th frame")] = 1
    descriptor_every: Annotated[int, Meta(ge=0, description="record the descriptors every K frames, 0 never")] = 30
    blueprint: Annotated[Literal["minimal", "default", "full"], Meta(description="how much the viewer shows")] = (
        "default"
    )
    show_lost: Annotated[bool, Meta(description="draw lost lines for as long as they are looked for")] = False
    application_id: Annotated[str, Meta(min_length=1, description="Rerun's application id")] = "airline-frontend"
    recording_id: Annotated[str, Meta(min_length=1, description="Rerun's recording id (default: a new one)")] | None = (
        None
    )
    layer: (
        Annotated[str, Meta(min_length=1, description="tracks alone, below this entity of somebody's recording")] | None
    ) = None
    coordinate_frame: (
        Annotated[str, Meta(min_length=1, description="that of the image below a layer, where it has a name")] | None
    ) = None
    frame_timeline: Annotated[str, Meta(min_length=1, description="timeline of the frames' numbers")] = "frame"
    time_timeline: Annotated[str, Meta(min_length=1, description="timeline of the frames' times")] = "sensor_time"

    def __post_init__(self) -> None:
        if self.layer is not None and self.recording_id is None:
            raise ConfigError("a layer belongs to somebody's recording: give its id with --recording-id")
        names = self.frame_timeline, self.time_timeline
        if self.layer is None and (self.coordinate_frame is not None or names != ("frame", "sensor_time")):
            raise ConfigError("--coordinate-frame and the timelines' names are for layers: give --layer ENTITY, too")
        if names[0] == names[1]:
            raise ConfigError(f"frames and times need timelines of their own, not both '{names[0]}'")
        if self.layer is not None and not re.fullmatch(r"/?[\w.-]+(/[\w.-]+)*", self.layer):
            raise ConfigError(f"'{self.layer}' is no entity for a layer: give a path such as camera/image")
        if self.layer is not None and self.layer.lstrip("/").startswith("__"):
            raise ConfigError(f"'{self.layer}' belongs to Rerun: give another entity")


class RunConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everything that decides the result of a run."""

    preset: Annotated[Preset, Meta(description="settings to start from")] = "default"
    runtime: Annotated[Runtime, Meta(description="what the edge network runs in")] = "auto"
    serial: Annotated[bool, Meta(description="do one thing after the other in one thread, for debugging")] = False
    input: InputConfig = InputConfig()
    detector: DetectorConfig = DetectorConfig()
    tracker: TrackerConfig = TrackerConfig()
    recording: RecordingConfig = RecordingConfig()


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
        raise ConfigError(f"setting {where.rstrip('`') or 'file'}: {what}; --dump-config prints all settings") from None


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

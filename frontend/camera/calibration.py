"""Camera calibrations in the files that calibration tools write.

What a file is shows in its content:

- EuRoC / ASL `sensor.yaml`: `resolution`, `intrinsics`, `distortion_model`, `distortion_coefficients`.
- Kalibr `camchain.yaml`: `cam0`, `cam1`, ..., each with `camera_model: pinhole`, `intrinsics`, `distortion_model`
  (radtan, equidistant or none), `distortion_coeffs`, `resolution`.
- ROS `camera_info` (camera_calibration, camera_info_manager; OpenCV's own calibration sample writes the same fields):
  `image_width`, `image_height`, `camera_matrix`, `distortion_model`, `distortion_coefficients`. The camera is that of
  the raw images.
- JSON (or YAML) of eight fields: `width`, `height`, `fx`, `fy`, `cx`, `cy` in px with (0, 0) at the centre of the
  top-left pixel, and optionally `distortion` ("none", "radial-tangential" or "equidistant") with `coefficients`.
"""

from __future__ import annotations

import logging
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from airline.errors import ConfigError, InputError
from frontend.camera.lens import lens
from frontend.camera.model import CameraModel
from frontend.camera.plain_yaml import Tree, read_tree

log = logging.getLogger(__name__)

_MAX_BYTES = 256 * 1024
MAX_SIDE = 65536  # px
LARGEST = 1e9  # of any calibrated number; beyond it float32 pixels mean nothing
_SIMPLE = frozenset({"width", "height", "fx", "fy", "cx", "cy", "distortion", "coefficients"})
_CAMERA = re.compile(r"cam\d{1,4}")


def read_calibration(path: str | os.PathLike[str], camera: str | None = None) -> CameraModel:
    """Read a camera from a calibration file; the kind of the file is told by its content, see above.

    Args:
        path: the file.
        camera: which one of several: the name in the file (in Kalibr's "cam1" or its `rostopic`). Without it the first
            of several is read, with a warning.

    Raises:
        InputError: the file cannot be read, or a field is missing or makes no sense.
        ConfigError: there is no such camera, or its model is not supported.
    """
    file = Path(path)
    tree = read_tree(file, _MAX_BYTES)
    if not isinstance(tree, dict):
        raise InputError(_unknown(file))
    chain = {name: entry for name, entry in tree.items() if _CAMERA.fullmatch(name) and isinstance(entry, dict)}
    if chain:
        name = _choose(chain, camera, file)
        return _euroc(_Fields(chain[name], file, f"{name}."))
    fields = _Fields(tree, file)
    named = tree.get("camera_name")
    if camera is not None and camera != named:
        only = f"'{named}'" if isinstance(named, str) else "one that has no name"
        raise ConfigError(f"'{file}' has no camera '{camera}', its only camera is {only}")
    if "camera_matrix" in tree:
        return _ros(fields)
    if "intrinsics" in tree:
        return _euroc(fields)
    if "fx" in tree:
        return _simple(fields)
    raise InputError(_unknown(file))


def fit_camera(camera: CameraModel, width: int, height: int) -> CameraModel:
    """The camera for images of another resolution, up to a pixel of the same aspect ratio.

    Raises:
        InputError: the images are not the calibrated ones resized.
    """
    if (width, height) == (camera.width, camera.height):
        return camera
    if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):
        raise InputError(
            f"the calibration is for images of {camera.width}x{camera.height} px, these have {width}x{height}: "
            "calibrate for this resolution"
        )
    return camera.scaled(width, height)


class _Fields:
    """Checked access to the fields of a mapping; `prefix` completes their names in messages."""

    def __init__(self, tree: Mapping[str, Tree], file: Path, prefix: str = "") -> None:
        self.tree, self.file, self._prefix = tree, file, prefix

    def wrong(self, name: str, what: str) -> InputError:
        return InputError(f"'{self.file}': {self._prefix}{name} {what}")

    def text(self, name: str, default: str | None = None) -> str:
        value = self.tree.get(name, default)
        if value is None:
            raise self.wrong(name, "is missing")
        if not isinstance(value, str):
            raise self.wrong(name, "must be a name")
        return value

    def numbers(self, name: str, count: int | None = None) -> list[float]:
        """A list of finite numbers, also in the form {rows, cols, data}."""
        value = self.tree.get(name)
        if isinstance(value, dict):
            value = value.get("data")
        if value is None:
            raise self.wrong(name, "is missing")
        if not isinstance(value, list) or any(isinstance(item, (dict, list)) for item in value):
            raise self.wrong(name, "must be a list of numbers")
        if count is not None and len(value) != count:
            raise self.wrong(name, f"must hold {count} numbers, not {len(value)}")
        return [self._number(name, item) for item in value]

    def number(self, name: str) -> float:
        if self.tree.get(name) is None:
            raise self.wrong(name, "is missing")
        return self._number(name, self.tree[name])

    def size(self, name: str, value: float | None = None) -> int:
        """A side of an image, px."""
        number = self.number(name) if value is None else value
        if not (1 <= number <= MAX_SIDE and number == int(number)):
            raise self.wrong(name, f"must be 1 to {MAX_SIDE} px, not {number:g}")
        return int(number)

    def _number(self, name: str, value: Any) -> float:
        try:
            number = float(value) if isinstance(value, str) else math.nan
        except ValueError:
            number = math.nan
        if not abs(number) <= LARGEST:  # NaN, too
            shown = f"{value[:40]!r}" if isinstance(value, str) else "that"
            raise self.wrong(name, f"must be a number, not {shown}")
        return number

    def camera(self, size: tuple[int, int], pinhole: list[float], model: str, coefficients: list[float]) -> CameraModel:
        """The camera, from its size, (fx, fy, cx, cy), and distortion."""
        fx, fy, cx, cy = pinhole
        try:
            return CameraModel(*size, fx, fy, cx, cy, *lens(model, coefficients))
        except ConfigError as error:
            raise ConfigError(f"'{self.file}': {error}") from None


def _choose(chain: Mapping[str, Mapping[str, Tree]], wanted: str | None, file: Path) -> str:
    if wanted is not None:
        for name, entry in chain.items():
            if wanted in (name, entry.get("rostopic")):
                return name
        raise ConfigError(f"'{file}' has no camera '{wanted}': it has {', '.join(chain)}")
    name = min(chain, key=lambda name: int(name[3:]))
    if len(chain) > 1:
        log.warning("'%s' holds %s: using %s", file, ", ".join(chain), name)
    return name


def _euroc(fields: _Fields) -> CameraModel:
    """EuRoC and Kalibr, which differ in the name of the coefficients."""
    model = fields.text("camera_model", "pinhole")
    if model != "pinhole":
        raise ConfigError(f"'{fields.file}': camera model '{model[:40]}' is not supported: calibrate with 'pinhole'")
    width, height = fields.numbers("resolution", 2)
    size = fields.size("resolution", width), fields.size("resolution", height)
    pinhole = fields.numbers("intrinsics", 4)
    name = "distortion_coeffs" if "distortion_coeffs" in fields.tree else "distortion_coefficients"
    distortion = fields.text("distortion_model", "none")
    without = distortion == "none" and name not in fields.tree
    return fields.camera(size, pinhole, distortion, [] if without else fields.numbers(name))


def _ros(fields: _Fields) -> CameraModel:
    size = fields.size("image_width"), fields.size("image_height")
    k = fields.numbers("camera_matrix", 9)
    if k[1] or k[3] or k[6] or k[7] or k[8] != 1:
        raise fields.wrong("camera_matrix", "must be of the form fx 0 cx, 0 fy cy, 0 0 1")
    fisheye = fields.tree.get("fisheye_model", "0") != "0"  # OpenCV's sample names no model
    model = fields.text("distortion_model", "equidistant" if fisheye else "plumb_bob")
    return fields.camera(size, [k[0], k[4], k[2], k[5]], model, fields.numbers("distortion_coefficients"))


def _simple(fields: _Fields) -> CameraModel:
    unknown = sorted(fields.tree.keys() - _SIMPLE)
    if unknown:
        raise fields.wrong(unknown[0][:40], f"is no field of a calibration: use {', '.join(sorted(_SIMPLE))}")
    size = fields.size("width"), fields.size("height")
    pinhole = [fields.number(name) for name in ("fx", "fy", "cx", "cy")]
    coefficients = fields.numbers("coefficients") if "coefficients" in fields.tree else []
    return fields.camera(size, pinhole, fields.text("distortion", "none"), coefficients)


def _unknown(file: Path) -> str:
    return (
        f"'{file}' is no camera calibration: give a EuRoC sensor.yaml, a Kalibr camchain, a ROS camera_info YAML, or "
        'JSON such as {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 319.5, "cy": 239.5}'
    )

"""Distortion models by the names that calibration files, ROS and Foxglove give them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from frontend.camera.model import COUNTS, Distortion

_NONE = frozenset({"", "none", "no_distortion", "pinhole"})
_RADIAL_TANGENTIAL = frozenset(
    {"plumb_bob", "rational_polynomial", "radtan", "radial_tangential", "radialtangential", "brown_conrady"}
)
_EQUIDISTANT = frozenset({"equidistant", "equi", "fisheye", "opencv_fisheye", "kannala_brandt", "kannala_brandt4"})


def lens(model: str, coefficients: Sequence[float]) -> tuple[Distortion, NDArray[np.float64]]:
    """What `CameraModel` calls a distortion.

    Args:
        model: a name such as "plumb_bob", "radtan" or "kannala_brandt"; case, blanks and hyphens do not matter.
            Without a name there may be no coefficients other than zeros.
        coefficients: in the order of OpenCV. Zeros behind the last that the model takes are dropped (OpenCV writes up
            to 14), radial-tangential ones that are all zero are no distortion; an equidistant lens with zeros remains.

    Raises:
        ConfigError: the model is unknown, or the number of coefficients is wrong.
    """
    name = model.strip().lower().replace("-", "_").replace(" ", "_")
    values = list(map(float, coefficients))
    distortion: Distortion
    if name in _EQUIDISTANT:
        distortion = "equidistant"
    elif not any(values) and (name in _NONE or name in _RADIAL_TANGENTIAL):
        return "none", np.zeros(0)
    elif name in _RADIAL_TANGENTIAL:
        distortion = "radial-tangential"
    elif name in _NONE:
        raise ConfigError(f"distortion '{model}' goes with no coefficients other than zeros, not with {len(values)}")
    else:
        known = "plumb_bob (radtan), rational_polynomial or equidistant (fisheye, kannala_brandt)"
        raise ConfigError(f"distortion model '{model[:40]}' is not supported: calibrate for {known}")
    used = max((place for place, value in enumerate(values, 1) if value), default=0)
    for count in COUNTS[distortion]:
        if used <= count <= len(values):
            return distortion, np.array(values[:count])
    expected = " or ".join(map(str, COUNTS[distortion]))
    raise ConfigError(f"distortion '{model}' takes {expected} coefficients, not {len(values)}")

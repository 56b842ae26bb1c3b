"""Camera models: from pixels to normalised image coordinates and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.lines import scale_points
from frontend.camera.distortion import (
    distort_equidistant,
    distort_radial_tangential,
    undistort_equidistant,
    undistort_radial_tangential,
)
from frontend.space import is_rigid

Distortion = Literal["none", "radial-tangential", "equidistant"]
MAX_SIDE = 65536  # px, of an image that a file declares
LARGEST = 1e9  # of any calibrated number; beyond it float32 pixels mean nothing
COUNTS: dict[str, tuple[int, ...]] = {"none": (0,), "radial-tangential": (4, 5, 8), "equidistant": (4,)}
"""How many coefficients a distortion takes."""
_NONE = frozenset({"", "none", "no_distortion", "pinhole"})
_RADIAL_TANGENTIAL = frozenset(
    {"plumb_bob", "rational_polynomial", "radtan", "radial_tangential", "radialtangential", "brown_conrady"}
)
_EQUIDISTANT = frozenset(
    {"equidistant", "equi", "fisheye", "opencv_fisheye", "kannala_brandt", "kannala_brandt4", "kannalabrandt"}
)


@dataclass(frozen=True)
class CameraModel:
    """A pinhole camera with optional lens distortion.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        fx: focal length, px.
        fy: focal length, px.
        cx: principal point, px, with (0, 0) at the centre of the top-left pixel.
        cy: principal point, px.
        distortion: "none", "radial-tangential" (k1, k2, p1, p2[, k3[, k4, k5, k6]]: OpenCV, ROS plumb_bob and
            rational_polynomial) or "equidistant" (k1..k4: the Kannala-Brandt fisheye of OpenCV and Kalibr).
        coefficients: (K,) float64 of the distortion in that order.
        rig_from_camera: (4, 4) float64 rigid motion, m, from the camera's frame to one that it shares with the other
            cameras of its calibration; None where that is not known.
        baseline_m: how far the second camera of a rectified pair lies to the right of this one, m; 0 where it is none.
        disparity_offset: cx minus the second camera's, px: the disparity of points at infinity.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion = "none"
    coefficients: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    rig_from_camera: NDArray[np.float64] | None = field(default=None, kw_only=True, compare=False, repr=False)
    baseline_m: float = field(default=0.0, kw_only=True)
    disparity_offset: float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        if self.distortion not in COUNTS:
            raise ConfigError(f"unknown distortion '{self.distortion}': use {', '.join(COUNTS)}")
        counts = COUNTS[self.distortion]
        if len(self.coefficients) not in counts:
            expected = " or ".join(map(str, counts))
            raise ConfigError(
                f"{self.distortion} distortion takes {expected} coefficients, not {len(self.coefficients)}"
            )
        if not (np.isfinite((self.fx, self.fy, self.cx, self.cy)).all() and self.fx > 0 and self.fy > 0):
            raise ConfigError("focal lengths must be positive pixels, and the principal point finite ones")
        if not (0 <= self.baseline_m <= LARGEST and abs(self.disparity_offset) <= LARGEST):  # NaN fails, too
            raise ConfigError("a pair's baseline must be zero or more metres, and its disparity offset a finite number")
        if self.rig_from_camera is not None and not is_rigid(self.rig_from_camera):
            raise ConfigError("rig_from_camera must be a (4, 4) rotation and translation")

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3) float64 intrinsic matrix, px."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    def normalize(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Undistorted coordinates on the plane z = 1 of pixel positions (..., 2); the inverse of `project`.

        Returns:
            (..., 2) float32 normalised coordinates, exact to float32. Both are NaN where the distortion has no inverse:
            beyond the radius at which it folds the image back, and 90 degrees and more off the axis.
        """
        flat = np.asarray(points, np.float64).reshape(-1, 2)
        plane = (flat - (self.cx, self.cy)) / (self.fx, self.fy)
        if self.distortion == "radial-tangential":
            plane = undistort_radial_tangential(plane, self.coefficients)
        elif self.distortion == "equidistant":
            plane = undistort_equidistant(plane, self.coefficients)
        return np.asarray(plane.reshape(np.shape(points)), np.float32)

    def project(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Pixel positions of (..., 2) undistorted coordinates (X / Z, Y / Z); the inverse of `normalize`.

        Returns:
            (..., 2) float32 px, which may lie outside of the image; NaN outside of the distortion's domain, where
            it would fold them back into the image.
        """
        plane = np.asarray(points, np.float64).reshape(-1, 2)
        if self.distortion == "radial-tangential":
            plane = distort_radial_tangential(plane, self.coefficients)
        elif self.distortion == "equidistant":
            plane = distort_equidistant(plane, self.coefficients)
        pixels = plane * (self.fx, self.fy) + (self.cx, self.cy)
        return np.asarray(pixels.reshape(np.shape(points)), np.float32)

    def scaled(self, width: int, height: int) -> CameraModel:
        """The same camera for images resized to width x height px."""
        sx, sy = width / self.width, height / self.height
        cx, cy = scale_points(self.cx, sx), scale_points(self.cy, sy)
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=cx,
            cy=cy,
            disparity_offset=self.disparity_offset * sx,
        )


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

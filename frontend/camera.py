"""Camera models: from pixels to normalised image coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError

Distortion = Literal["none", "radial-tangential", "equidistant"]


def _no_coefficients() -> NDArray[np.float64]:
    return np.zeros(0)


@dataclass(frozen=True)
class CameraModel:
    """A pinhole camera with optional lens distortion.

    Attributes:
        width, height: image size, px.
        fx, fy, cx, cy: focal lengths and principal point, px, with (0, 0) at the centre of the top-left pixel.
        distortion: "none", "radial-tangential" (k1, k2, p1, p2[, k3[, k4, k5, k6]]: OpenCV, ROS plumb_bob and
            rational_polynomial) or "equidistant" (k1..k4: the Kannala-Brandt fisheye of OpenCV and Kalibr).
        coefficients: the distortion's coefficients in that order.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion = "none"
    coefficients: NDArray[np.float64] = field(default_factory=_no_coefficients)

    def __post_init__(self) -> None:
        sizes = {"none": (0,), "radial-tangential": (4, 5, 8), "equidistant": (4,)}.get(self.distortion)
        if sizes is None:
            raise ConfigError(f"unknown distortion '{self.distortion}': use none, radial-tangential or equidistant")
        if len(self.coefficients) not in sizes:
            expected = " or ".join(map(str, sizes))
            raise ConfigError(
                f"{self.distortion} distortion takes {expected} coefficients, not {len(self.coefficients)}"
            )
        if self.fx <= 0 or self.fy <= 0:
            raise ConfigError("focal lengths must be positive pixels")

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3) float64 intrinsic matrix, px."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    def normalize(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Undistorted coordinates on the plane z = 1 of pixel positions.

        Args:
            points: (..., 2) pixel positions (x, y).

        Returns:
            (..., 2) float32 normalised coordinates.
        """
        if self.distortion == "none":
            centre = np.array([self.cx, self.cy])
            plane: NDArray[np.float32] = ((points - centre) / np.array([self.fx, self.fy])).astype(np.float32)
            return plane
        import cv2

        flat = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 2)
        if not len(flat):
            return np.zeros(points.shape, np.float32)
        undistort = cv2.fisheye.undistortPoints if self.distortion == "equidistant" else cv2.undistortPoints
        plane = undistort(flat, self.matrix, self.coefficients).reshape(points.shape).astype(np.float32)
        return plane

    def scaled(self, width: int, height: int) -> CameraModel:
        """The same camera for images resized to width x height px."""
        sx, sy = width / self.width, height / self.height
        return CameraModel(
            width,
            height,
            self.fx * sx,
            self.fy * sy,
            (self.cx + 0.5) * sx - 0.5,
            (self.cy + 0.5) * sy - 0.5,
            self.distortion,
            self.coefficients,
        )

"""Images in which straight things are straight: lens distortion removed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from frontend.camera.model import CameraModel
from frontend.sources.reading import Image

Array = NDArray[np.float64]

WIDEST_DEG = 60.0  # off the axis, that an undistorted image reaches at most; a pinhole stretches it fourfold there
_BORDER_POINTS = 200  # per side
_COMPASS = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]


class Undistorter:
    """Remaps the images of one camera to those of `undistorted_camera`, with the same errors."""

    def __init__(self, source: CameraModel) -> None:
        self._source = source
        self._maps: tuple[Any, Any] | None = None
        self.camera = source
        if source.distortion != "none":
            self.camera = undistorted_camera(source)
            self._maps = maps_between(source, self.camera)

    def fits(self, source: CameraModel) -> bool:
        """Whether images of this camera can be remapped, too."""
        return source is self._source or values_of(source) == values_of(self._source)

    def __call__(self, image: Image) -> Image:
        """(H, W[, 3]) uint8 or uint16 image of the source's size; bilinear, positions to 1/32 px."""
        return image if self._maps is None else remapped(image, self._maps)


def maps_between(source: CameraModel, new: CameraModel, turn: Array | None = None) -> tuple[Any, Any]:
    """Where each pixel of `new` is in the source's image, for `remapped`; `turn` is source from new, (3, 3)."""
    columns, rows = np.meshgrid(np.arange(new.width), np.arange(new.height))
    plane = np.stack([(columns - new.cx) / new.fx, (rows - new.cy) / new.fy], axis=-1)
    maps: tuple[Any, Any] = cv2.convertMaps(source.project(turned(plane, turn)), None, cv2.CV_16SC2)  # the fastest form
    return maps


def turned(plane: Array, turn: Array | None) -> Array:
    """Points (..., 2) of the plane z = 1 as a camera sees them that is turned by (3, 3); NaN behind it."""
    if turn is None:
        return plane
    rays = plane @ turn[:, :2].T + turn[:, 2]
    return np.asarray(rays[..., :2] / np.where(rays[..., 2:] > 0, rays[..., 2:], np.nan))


def remapped(image: Image, maps: tuple[Any, Any]) -> Image:
    """(H, W[, 3]) uint8 or uint16 by `maps_between`; bilinear, positions to 1/32 px."""
    new: Image = cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return new


def undistorted_camera(camera: CameraModel) -> CameraModel:
    """The pinhole camera without distortion whose image a camera's image fills without a border.

    It has the same size and fx / fy, and sees as much as these and `WIDEST_DEG` allow.

    Raises:
        InputError: the camera's model has no inverse in the middle of its image.
    """
    middle = np.array([camera.width - 1, camera.height - 1]) / 2
    found = filled_camera(camera, camera.normalize(middle).astype(np.float64), lambda plane: covers(camera, plane))
    if found is None:
        raise InputError("the calibration makes no sense in the middle of the image: it cannot be undistorted")
    return found


def filled_camera(camera: CameraModel, centre: Array, covered: Callable[[Array], bool]) -> CameraModel | None:
    """The pinhole camera of another's size and fx / fy that sees as much as possible of what is covered.

    Args:
        camera: the other one.
        centre: (2,) of the plane z = 1, where to begin.
        covered: whether all of these points (N, 2) of that plane are; then what they enclose is, too.

    Returns:
        None where nothing around the centre is covered.
    """
    last = np.array([camera.width - 1, camera.height - 1], np.float64)
    side = 0.5 * last / (camera.fx, camera.fy)  # half sides of the image on the plane z = 1, without zoom
    along, one = np.linspace(-1, 1, _BORDER_POINTS), np.ones(_BORDER_POINTS)
    sides = [(along, -one), (along, one), (-one, along), (one, along)]
    border = np.concatenate([np.stack(pair, axis=1) for pair in sides]) * side  # around the middle

    def zoom(centre: Array, known: float, high: float) -> float:
        """The largest factor of `border` around `centre` that the image covers; `known` is one that it covers."""
        while high - known > 1e-5 * known:
            middle = 0.5 * (known + high)
            known, high = (middle, high) if covered(centre + middle * border) else (known, middle)
        return known

    size = 1e-3
    if not np.isfinite(centre).all() or not covered(centre + size * border):
        return None
    size = zoom(centre, size, 2 * math.tan(math.radians(WIDEST_DEG)) / float(side.min()))
    step = 0.1
    while step > 1e-3:
        for direction in _COMPASS:
            moved = centre + step * size * side * direction
            if covered(moved + size * (1 + 1e-4) * border):
                centre, size = moved, zoom(moved, size * (1 + 1e-4), 2 * size)
                break
        else:
            step /= 2
    fx, fy = camera.fx / size, camera.fy / size
    cx, cy = 0.5 * last - centre * (fx, fy)
    return CameraModel(camera.width, camera.height, fx, fy, float(cx), float(cy))


def covers(camera: CameraModel, plane: Array, turn: Array | None = None) -> bool:
    """Whether the image of a camera, perhaps a turned one, shows all these points (N, 2), none too far off the axis."""
    if np.hypot(*plane.T).max() > math.tan(math.radians(WIDEST_DEG)):
        return False
    x, y = camera.project(turned(plane, turn)).T
    return bool(((x >= 0) & (x <= camera.width - 1) & (y >= 0) & (y <= camera.height - 1)).all())  # false for NaN


def values_of(camera: CameraModel) -> tuple[object, ...]:
    """All that a camera's maps depend on, to be compared."""
    size, rig = (camera.width, camera.height), camera.rig_from_camera
    lens = camera.distortion, *camera.coefficients.tolist()
    return (*size, camera.fx, camera.fy, camera.cx, camera.cy, *lens, None if rig is None else rig.tolist())

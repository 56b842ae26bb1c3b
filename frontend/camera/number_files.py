"""Cameras in the files of numbers that data sets come with; which format a file has shows in the form of its rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from airline.errors import InputError
from frontend.camera.model import LARGEST, MAX_SIDE, CameraModel, lens
from frontend.camera.rig import inverse, rig_of_projection, rigid

Row = tuple[str, list[float]]

_ROW = re.compile(r"(?:([A-Za-z]\w*):?\s+)?(.*)")
_DSO = {5: "FOV", 8: "RadTan"}  # without a name, by how many numbers there are


class NumberedCamera(NamedTuple):
    """What `Calibration` holds of such a file."""

    camera: CameraModel
    which: str = ""
    y_up: bool = False
    number: int | None = None


def number_rows(text: str) -> list[Row] | None:
    """Names ("" for none) and numbers of the rows, no numbers where there are words; None for another kind of file."""
    rows: list[Row] = []
    for line in map(str.strip, text.splitlines()):
        match = _ROW.fullmatch(line)
        if not line or line.startswith("#") or match is None:
            continue
        try:
            numbers = [float(word) for word in match[2].split()]
        except ValueError:
            numbers = []
        rows.append((match[1] or "", numbers))
    return rows if rows and (len(rows[0][1]) > 1 or _is_kitti_raw(rows)) else None


def camera_of(rows: list[Row], number: int, *, rectified: bool) -> NumberedCamera:
    """The camera, of size 0 where the file does not tell it.

    - KITTI's odometry: rows `P0: 3x4 projection matrix` to P3, or such matrices without names.
    - KITTI's raw data: rows `S_rect_00: width height`, `P_rect_00: 3x4`, and for images that are not rectified `S_00`,
      `K_00: 3x3`, `D_00: k1 k2 p1 p2 k3`, `R_00: 3x3`, `T_00: 3`.
    - ICL-NUIM's and ScanNet's intrinsic matrices, 3x3 and 4x4.
    - TUM RGB-D's numbers `fx fy cx cy [k1 k2 p1 p2 [k3]]`.
    - DSO: `[model] fx fy cx cy coefficients`, then `width height`; relative to these where cx and cy are below 1.

    Args:
        rows: of `number_rows`.
        number: of the camera, where a file has several.
        rectified: whether the images are, where a file has both.

    Raises:
        InputError: a number is missing or makes no sense.
        ConfigError: the lens model is not supported.
    """
    if not all(abs(value) <= LARGEST for _, numbers in rows for value in numbers):  # NaN fails, too
        raise InputError(f"it has numbers that are not finite, or beyond {LARGEST:g}")
    (name, first), counts = rows[0], [len(numbers) for _, numbers in rows]
    if _is_kitti_raw(rows):
        return _kitti_raw(dict(rows), number, rectified)
    if len(first) == 12:
        number = number if name or number < len(rows) else 0
        which = f"P{number}" if name else f"row {number + 1}"
        values = _numbers(dict(rows) if name else {which: rows[number][1]}, which, 12)
        return _projected(values, (0, 0), which, number)
    if counts in ([3] * 3, [4] * 4):
        matrix = [value for _, numbers in rows[:3] for value in numbers[:3]]
        y_up = matrix[4] < 0
        matrix[4] = abs(matrix[4])
        return NumberedCamera(_camera(intrinsics(matrix)), y_up=y_up)
    if len(rows) == 1 and len(first) in (4, 8, 9) and not name:
        return NumberedCamera(_camera(first[:4], "radtan", first[4:]))
    if counts[:2] in ([5, 2], [8, 2]) and len(rows) == 4:
        return NumberedCamera(_dso(name, first, _size(rows[1][1])))
    raise InputError(f"it has rows of {', '.join(map(str, counts[:4]))} numbers, as no calibration that is known here")


def _is_kitti_raw(rows: list[Row]) -> bool:
    return any(name.startswith("P_rect_") for name, _ in rows)


def intrinsics(matrix: Sequence[float]) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a 3x3 matrix row by row; raises InputError for one of another form."""
    fx, skew, cx, below, fy, cy, *last = matrix
    if skew or below or last != [0, 0, 1]:
        raise InputError("the camera matrix must be of the form fx 0 cx, 0 fy cy, 0 0 1")
    return fx, fy, cx, cy


def _camera(
    pinhole: Sequence[float], model: str = "none", coefficients: Sequence[float] = (), size: tuple[int, int] = (0, 0)
) -> CameraModel:
    fx, fy, cx, cy = pinhole
    return CameraModel(*size, fx, fy, cx, cy, *lens(model, coefficients))


def left_3x3(projection: Sequence[float]) -> list[float]:
    """Row by row, the 3x3 of a 3x4 matrix, whose last column is the stereo baseline."""
    return [value for k, value in enumerate(projection) if k % 4 < 3]


def _projected(projection: Sequence[float], size: tuple[int, int], which: str, number: int) -> NumberedCamera:
    camera = _camera(intrinsics(left_3x3(projection)), size=size)
    return NumberedCamera(replace(camera, rig_from_camera=rig_of_projection(projection)), which, number=number)


def _kitti_raw(rows: dict[str, list[float]], number: int, rectified: bool) -> NumberedCamera:
    key = f"{number:02}"
    if rectified:
        size, p = _size(_numbers(rows, f"S_rect_{key}", 2)), _numbers(rows, which := f"P_rect_{key}", 12)
        return _projected(p, size, which, number)
    size, k = _size(_numbers(rows, f"S_{key}", 2)), _numbers(rows, which := f"K_{key}", 9)
    camera = _camera(intrinsics(k), "radtan", _numbers(rows, f"D_{key}", 5), size)
    if f"R_{key}" in rows and f"T_{key}" in rows:  # from the first camera's frame
        turn, move = _numbers(rows, f"R_{key}", 9), _numbers(rows, f"T_{key}", 3)
        motion = rigid(np.column_stack([np.reshape(turn, (3, 3)), move]), f"R_{key} with T_{key}")
        camera = replace(camera, rig_from_camera=inverse(motion))
    return NumberedCamera(camera, which, number=number)


def _dso(name: str, numbers: list[float], size: tuple[int, int]) -> CameraModel:
    (fx, fy, cx, cy), coefficients, (width, height) = numbers[:4], numbers[4:], size
    if cx < 1 and cy < 1:  # from the corner of the first pixel, as shares of the sides
        fx, fy, cx, cy = fx * width, fy * height, cx * width - 0.5, cy * height - 0.5
    model = name or _DSO[len(numbers)]
    if model in ("FOV", "Pinhole") and not any(coefficients):
        model = "none"
    return _camera((fx, fy, cx, cy), model, coefficients, size)


def _numbers(rows: dict[str, list[float]], name: str, count: int) -> list[float]:
    if len(rows.get(name, ())) != count:
        raise InputError(f"row {name} must be {count} numbers")
    return rows[name]


def _size(numbers: list[float]) -> tuple[int, int]:
    if not all(1 <= side <= MAX_SIDE and side % 1 == 0 for side in numbers):
        raise InputError(f"the images' width and height must be whole numbers from 1 to {MAX_SIDE}")
    width, height = map(int, numbers)
    return width, height

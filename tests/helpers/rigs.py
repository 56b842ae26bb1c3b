"""Two cameras on a rig, and their calibration as the files of tools and data sets write it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera.model import CameraModel
from frontend.camera.rig import inverse

Array = NDArray[np.float64]
LENSES = {
    "none": ("none", []),
    "radial": ("radial-tangential", [-0.28, 0.07, 0.0002, 0.00002]),
    "rational": ("radial-tangential", [11.7, 6.2, 0.0004, -0.0003, 0.3, 12.1, 9.8, 1.9]),
    "fisheye": ("equidistant", [0.0035, 0.0007, -0.002, 0.0002]),
}


def motion(rotation: list[float], place: list[float]) -> Array:
    """(4, 4) from a rotation vector, radians, and a place, m."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_rotvec(rotation).as_matrix(), place
    return found


def rig(left: str = "radial", right: str = "radial", turn: float = 1.0) -> tuple[CameraModel, CameraModel]:
    """Unlike cameras, each turned by a few degrees times `turn`, on a body with axes of its own."""
    body = motion([0.9, -1.3, 0.4], [0.3, -0.2, 0.1])
    poses = motion([0, 0, 0], [0, 0, 0]), motion([0.03 * turn, -0.05 * turn, 0.02 * turn], [0.12, 0.006, -0.004])
    cameras = []
    for name, pose, focal, shift in ((left, poses[0], 1.0, -3.0), (right, poses[1], 1.02, 6.0)):
        model, coefficients = LENSES[name]
        f = (0.35 if model == "equidistant" else 0.65) * 640 * focal
        camera = CameraModel(640, 480, f, 1.01 * f, 320 + shift, 238 - shift, model, np.array(coefficients))  # type: ignore[arg-type]
        cameras.append(replace(camera, rig_from_camera=body @ pose))
    return cameras[0], cameras[1]


def rows_of(numbers: object) -> str:
    return "[" + ", ".join(f"{number!r}" for number in np.ravel(np.asarray(numbers, np.float64)).tolist()) + "]"


def euroc(camera: CameraModel) -> str:
    """EuRoC's sensor.yaml."""
    return f"""%YAML:1.0
T_BS: {{cols: 4, rows: 4, data: {rows_of(camera.rig_from_camera)}}}
resolution: [{camera.width}, {camera.height}]
camera_model: pinhole
intrinsics: [{camera.fx!r}, {camera.fy!r}, {camera.cx!r}, {camera.cy!r}]
distortion_model: {camera.distortion}
distortion_coefficients: {rows_of(camera.coefficients)}
"""


def kalibr(left: CameraModel, right: CameraModel, *, imu: bool = False) -> str:
    """Kalibr's camchain, by its chain or by the IMU alone."""
    text = ""
    right_from_left = inverse(right.rig_from_camera) @ left.rig_from_camera
    for name, camera in (("cam0", left), ("cam1", right)):
        key, pose = ("T_cam_imu", inverse(camera.rig_from_camera)) if imu else ("T_cn_cnm1", right_from_left)
        places = "".join(f"  - {rows_of(row)}\n" for row in pose) if imu or camera is right else ""
        text += f"""{name}:
{f"  {key}:" if places else ""}
{places}  rostopic: /{name.replace("cam", "topic_")}
  camera_model: pinhole
  distortion_model: {"radtan" if camera.distortion == "radial-tangential" else camera.distortion}
  distortion_coeffs: {rows_of(camera.coefficients)}
  intrinsics: [{camera.fx!r}, {camera.fy!r}, {camera.cx!r}, {camera.cy!r}]
  resolution: [{camera.width}, {camera.height}]
"""
    return text


def kitti_raw(left: CameraModel, right: CameraModel) -> str:
    """KITTI's calib_cam_to_cam.txt of the raw images."""
    text = "calib_time: 09-Jan-2012 13:57:47\n"
    for number, camera in enumerate((left, right)):
        pose = inverse(camera.rig_from_camera) @ left.rig_from_camera
        rows = {"S": [camera.width, camera.height], "K": camera.matrix, "D": [*camera.coefficients, 0.0][:5]}
        rows |= {"R": pose[:3, :3], "T": pose[:3, 3], "S_rect": [640, 480], "R_rect": np.eye(3), "P_rect": np.eye(3, 4)}
        for name, numbers in rows.items():
            text += f"{name}_{number:02}: {' '.join(repr(float(n)) for n in np.ravel(numbers))}\n"
    return text


def rectification(left: CameraModel, right: CameraModel) -> list[tuple[Array, Array]]:
    """R (3, 3) and P (3, 4) of both as ROS's stereo calibration makes them: x along the baseline."""
    baseline = (right.rig_from_camera - left.rig_from_camera)[:3, 3]
    x = baseline / np.linalg.norm(baseline)
    y = np.cross(left.rig_from_camera[:3, 2], x)
    y /= np.linalg.norm(y)
    new_from_rig = np.array([x, y, np.cross(x, y)])
    found = []
    for camera, shift in ((left, 0.0), (right, np.linalg.norm(baseline))):
        projection = np.array([[400.0, 0, 318, -400 * shift], [0, 400, 242, 0], [0, 0, 1, 0]])
        found.append((new_from_rig @ camera.rig_from_camera[:3, :3], projection))
    return found


def ros(camera: CameraModel, r: Array, p: Array) -> str:
    """ROS's camera_info YAML."""
    model = "equidistant" if camera.distortion == "equidistant" else "plumb_bob"
    return f"""image_width: {camera.width}
image_height: {camera.height}
camera_name: some
camera_matrix: {{rows: 3, cols: 3, data: {rows_of(camera.matrix)}}}
distortion_model: {model}
distortion_coefficients: {{rows: 1, cols: 5, data: {rows_of([*camera.coefficients, 0.0][:5])}}}
rectification_matrix: {{rows: 3, cols: 3, data: {rows_of(r)}}}
projection_matrix: {{rows: 3, cols: 4, data: {rows_of(p)}}}
"""


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path

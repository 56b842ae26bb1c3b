"""Rectified pairs against the geometry of both cameras, and the same rig out of every kind of calibration."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airline.errors import InputError
from frontend.camera.calibration import read_calibration, read_pair
from frontend.camera.model import CameraModel
from frontend.camera.rig import inverse
from frontend.stereo.rectify import Rectifier
from logs.calibration import camera_of
from logs.messages.types import CameraInfo
from tests.helpers import rigs
from tests.helpers.rigs import motion, rig, write

STEPS = 64  # per px, of coordinates in images


def sources_of(rectifier: Rectifier, width: int = 640, height: int = 480) -> list[np.ndarray]:
    """(H, W, 2) px per camera: which point of the raw image each pixel of the rectified one shows."""
    across, down = (STEPS * np.indices((height, width))[::-1]).astype(np.uint16)
    x, y = rectifier(across, across), rectifier(down, down)
    return [np.stack(pair, axis=-1) / STEPS for pair in zip(x, y, strict=True)]


@pytest.mark.parametrize(
    ("left", "right", "turn"),
    [
        *(("radial", "radial", 1.0), ("none", "none", 2.0), ("rational", "radial", -1.0), ("fisheye", "fisheye", 1.0)),
        ("none", "none", 0.0),
    ],
)
def test_a_point_in_space_is_in_one_row_at_its_disparity(left: str, right: str, turn: float) -> None:
    cameras = rig(left, right, turn)
    rectifier = Rectifier(*cameras)
    new = rectifier.camera
    assert rectifier.remaps
    assert (new.width, new.height, new.distortion, new.disparity_offset) == (640, 480, "none", 0)
    lefts, rights = sources_of(rectifier)
    rng = np.random.default_rng(0)
    disparity = rng.integers(2, 120, 3000)
    x, y = rng.integers(disparity, 640), rng.integers(0, 480, 3000)
    x[:4], y[:4], disparity[:4] = (639, 639, 120, 120), (0, 479, 0, 479), 120  # corners, too
    depth = new.fx * new.baseline_m / disparity
    plane = new.normalize(np.stack([x, y], axis=1)).astype(np.float64)
    distance = depth * np.sqrt(1 + (plane**2).sum(axis=1))
    # the point at that distance on the left raw pixel's ray
    ray = np.column_stack([cameras[0].normalize(lefts[y, x]).astype(np.float64), np.ones(3000)])
    points = distance[:, None] * ray / np.linalg.norm(ray, axis=1)[:, None]
    seen = motion_of(cameras) @ np.column_stack([points, np.ones(3000)]).T
    expected = cameras[1].project((seen[:2] / seen[2]).T)
    off = np.hypot(*(rights[y, x - disparity] - expected).T)
    assert off.max() < 0.15
    assert np.sqrt((off**2).mean()) < 0.04


def motion_of(cameras: tuple[CameraModel, CameraModel]) -> np.ndarray:
    """(4, 4) right from left."""
    left, right = (camera.rig_from_camera for camera in cameras)
    assert left is not None
    assert right is not None
    return inverse(right) @ left


def test_no_border_is_repeated_and_little_is_lost() -> None:
    lost = []  # px, at each side of each image
    for points in sources_of(Rectifier(*rig())):
        x, y = np.moveaxis(points, -1, 0)
        inside = (x > 0) & (x < 639) & (y > 0) & (y < 479)
        assert inside.mean() > 0.995
        lost += [x.min(), 639 - x.max(), y.min(), 479 - y.max()]
    assert np.sort(lost)[1] < 1  # it could not be larger or elsewhere
    assert max(lost) < 80  # of cameras that are turned by 3 degrees


def test_calibrations_of_one_rig_agree(tmp_path: Path) -> None:
    left, right = rig()
    truth = motion_of((left, right))
    chain = write(tmp_path / "chain.yaml", rigs.kalibr(left, right))
    by_imu = write(tmp_path / "imu.yaml", rigs.kalibr(left, right, imu=True))
    kitti = write(tmp_path / "calib_cam_to_cam.txt", rigs.kitti_raw(left, right))
    folders = "mav0/left/data", "mav0/right/data"
    found = {
        "Kalibr's chain": read_pair(chain, ("a", "b")),
        "Kalibr by IMU": read_pair(by_imu, folders),
        "KITTI raw": read_pair(kitti, ("x_extract/image_00", "x_extract/image_01")),
        "Kalibr by topic": read_pair(chain, ("/topic_1", "/topic_0"))[::-1],
        "one camera each": (read_calibration(chain, "cam0"), read_calibration(chain, "right/data")),
    }
    euroc = [write(tmp_path / name, rigs.euroc(one)) for name, one in (("0.yaml", left), ("1.yaml", right))]
    found["EuRoC"] = read_pair(euroc[0], folders, euroc[1])
    r_and_p = rigs.rectification(left, right)
    ros = [write(tmp_path / f"ros{k}.yaml", rigs.ros(one, *r_and_p[k])) for k, one in enumerate((left, right))]
    found["ROS"] = read_pair(ros[0], folders, ros[1])
    simple = []
    for k, one in enumerate((left, right)):
        numbers = {name: getattr(one, name) for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion")}
        numbers |= {"coefficients": one.coefficients.tolist(), "rig_from_camera": one.rig_from_camera.tolist()}
        simple.append(write(tmp_path / f"{k}.json", json.dumps(numbers)))
    found["JSON"] = read_pair(simple[0], folders, simple[1])
    pairs = {name: (one.camera, two.camera) for name, (one, two) in found.items()}
    pairs["messages"] = tuple(  # type: ignore[assignment]
        camera_of(
            CameraInfo(
                *(0, "cam", 640, 480, "plumb_bob", (*one.coefficients, 0.0), tuple(one.matrix.ravel())),
                *(tuple(numbers.ravel()) for numbers in r_and_p[k]),
            ),
            (640, 480),
            rectified=False,
        )
        for k, one in enumerate((left, right))
    )
    for name, cameras in pairs.items():
        np.testing.assert_allclose(motion_of(cameras), truth, atol=1e-9, err_msg=name)
        for ours, true in zip(cameras, (left, right), strict=True):
            assert ours.fx == true.fx, name
            np.testing.assert_array_equal(ours.coefficients[:4], true.coefficients, err_msg=name)


def test_rectified_messages() -> None:
    cameras = rig()
    found = []
    for camera, (r, p) in zip(cameras, rigs.rectification(*cameras), strict=True):
        numbers = (tuple(matrix.ravel()) for matrix in (camera.matrix, r, p))
        found.append(camera_of(CameraInfo(0, "", 640, 480, "plumb_bob", (0.1,) * 5, *numbers), (320, 240), True))
    rectifier = Rectifier(*found)
    assert not rectifier.remaps
    assert rectifier.camera.baseline_m == pytest.approx(np.linalg.norm([0.12, 0.006, 0.004]))
    assert (rectifier.camera.fx, rectifier.camera.distortion) == (200, "none")


PLACES = "718.856 0 607.1928 {x} 0 718.856 185.2157 {y} 0 0 1 {z}"


def test_rectified_pairs_stay_as_they_are(tmp_path: Path) -> None:
    rows = [(0, 0, 0), (-386.1448, 0, 0), (45.38225, -0.1130887, 0.003779761), (-337.2877, 2.369057, 0.004915215)]
    places = [PLACES.format(x=x, y=y, z=z) for x, y, z in rows]
    named = write(tmp_path / "calib.txt", "\n".join(f"P{k}: {row}" for k, row in enumerate(places)))
    bare = write(tmp_path / "bare.txt", "\n".join(places[:2]))
    for file, folders, baseline in (
        (named, ("image_0", "image_1"), 0.53716),
        (named, ("image_2", "image_3"), 0.53329),  # and 3 mm across, as it is in the data set
        (named, ("image_l", "image_r"), 0.53716),
        (bare, ("images", "images_right"), 0.53716),
        (bare, ("a", "b"), 0.53716),
    ):
        left, right = (replace(one.camera, width=1241, height=376) for one in read_pair(file, folders))
        rectifier = Rectifier(left, right)
        assert not rectifier.remaps
        assert rectifier.camera.baseline_m == pytest.approx(baseline, abs=1e-4)
        assert rectifier.camera.scaled(620, 188).baseline_m == rectifier.camera.baseline_m
        image = np.zeros((376, 1241), np.uint8)
        assert rectifier(image, image)[0] is image
    shifted = Rectifier(left, replace(right, cx=right.cx - 40)).camera
    assert (shifted.disparity_offset, shifted.scaled(2482, 752).disparity_offset) == (40, 80)
    assert Rectifier(left, right, rectified=True).camera == Rectifier(left, right).camera


def test_one_rectified_camera_is_enough_without_metres() -> None:
    camera, other = (replace(one, rig_from_camera=None) for one in rig("none", "none"))
    for right in (None, other):
        assert Rectifier(camera, right, rectified=True).camera is camera


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (motion([0, 0, 0], [-0.1, 0, 0]), "right camera stands to the left of the left one: swap"),
        (motion([0, 0, 0], [0.01, 0.1, 0]), "above or behind"),
        (motion([0, 0, 0], [0.01, 0, 0.1]), "above or behind"),
        (motion([0, 1.6, 0], [0.1, 0, 0]), "look different ways"),
        (motion([0, 0, 0], [0, 0, 0]), "same place"),
        (motion([0, 0.7, 0], [0.1, 0, 0]), "nothing in common"),
        (None, "where the two cameras are.*--right-calib"),
    ],
)
def test_what_is_no_pair(change: np.ndarray | None, said: str) -> None:
    model = CameraModel(640, 480, 1200.0, 1200.0, 319.5, 239.5, rig_from_camera=np.eye(4))
    with pytest.raises(InputError, match=said):
        Rectifier(model, replace(model, rig_from_camera=change))


@pytest.mark.parametrize(("lens", "said"), [("radial", "no lens distortion"), ("none", "the same rows")])
def test_rectified_by_word_and_not_by_calibration(lens: str, said: str) -> None:
    with pytest.raises(InputError, match=f"--rectified says.*{said}.*--calib none"):
        Rectifier(*rig(lens, lens), rectified=True)


@pytest.mark.parametrize("numbers", ["['a', 3]", "7", "[[1, [2]]]", "[.nan, 1]", "skewed", "mirrored", "last row"])
def test_what_is_no_place(tmp_path: Path, numbers: str) -> None:
    places = {"skewed": motion([0, 0, 0], [0, 0, 0]), "mirrored": np.diag([-1.0, 1, 1, 1]), "last row": np.eye(4)}
    places["skewed"][0, 1] = 0.01
    places["last row"][3, 0] = 1.0
    if numbers in places:
        numbers = rigs.rows_of(places[numbers])
    text = f"T_BS: {numbers}\n" + rigs.euroc(rig()[0]).partition("}\n")[2]
    with pytest.raises(InputError, match="T_BS"):
        read_calibration(write(tmp_path / "sensor.yaml", text))


def test_one_file_of_one_camera_is_no_pair(tmp_path: Path) -> None:
    file = write(tmp_path / "sensor.yaml", rigs.euroc(rig()[0]))
    with pytest.raises(InputError, match=r"holds one camera.*--right-calib"):
        read_pair(file, ("cam0", "cam1"))

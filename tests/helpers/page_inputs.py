"""The files that the documentation's commands take as given, tiny, made from the built-in clip."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag1 import Writer

from airline.scenes import RenderedClip
from tests.helpers.camera_logs import EPOCH_NS, Channel, Logged, write_log
from tests.helpers.camera_messages import ROS1, ROS2, cdr, image_fields, ros1
from tests.helpers.command import command
from tests.helpers.data_sets import write_annotated, write_labelled, write_posed
from viz.overlay import write_film

SIZE = (160, 120)
FRAMES = 24
STEP_NS = 500_000_000  # two per second: the pages skip the first ten seconds
LATER_NS = 600 * 10**9  # and of the log ten minutes; its second half is that much later
CAMERA = """camera_model: pinhole
resolution: [160, 120]
intrinsics: [115.0, 115.0, 79.5, 59.5]
distortion_model: radtan
distortion_coefficients: [-0.2, 0.05, 0.0, 0.0]
"""

SENSOR = """resolution: [160, 120]
intrinsics: [{f}, {f}, 79.5, 59.5]
distortion_model: none
T_BS: {{rows: 4, cols: 4, data: [1, 0, 0, {x}, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}}
"""
CHAIN = """cam0: {{resolution: [160, 120], intrinsics: [{f}, {f}, 79.5, 59.5], distortion_model: none}}
cam1:
  {{resolution: [160, 120], intrinsics: [{f}, {f}, 79.5, 59.5], distortion_model: none,
   T_cn_cnm1: [[1, 0, 0, -0.12], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}
"""

Images = list[np.ndarray]


def prepare(folder: Path) -> None:
    """Fill a folder with everything that the pages name."""
    clip = RenderedClip(motion="handheld", seed=12, frames=FRAMES, size=SIZE)
    images = [view.image for view in clip]
    right = [clip.render(k, right=True).image for k in range(FRAMES)]
    _write_folders(folder, images)
    _write_euroc(folder / "EuRoC" / "MH_01_easy" / "mav0", {"cam0": images, "cam1": right}, clip.K[0, 0])
    (folder / "camchain.yaml").write_text(CHAIN.format(f=clip.K[0, 0]))
    for name, film in {"video": images, "left": images, "right": right}.items():
        write_film(folder / f"{name}.mp4", film, 1e9 / STEP_NS)
    log = _write_log(folder / "log.mcap", images)
    _write_bag(folder / "drive.bag", images)
    (folder / "cut.mcap").write_bytes(log.read_bytes()[:-3000])
    (folder / "cam.yaml").write_text(CAMERA)
    (folder / "logs" / "deeper").mkdir(parents=True)
    shutil.copy(log, folder / "logs" / "drive.mcap")
    shutil.copy(folder / "video.mp4", folder / "logs" / "deeper" / "walk.mp4")
    write_annotated(folder / "yorkurban")
    write_labelled(folder / "icl_nuim")
    write_posed(folder / "kitti_clip")
    (folder / "docs").mkdir()
    recorded = command(folder / "images", "--headless", "--save", folder / "demo.rrd")
    assert recorded.code == 0, recorded.err
    (folder / "cut.rrd").write_bytes((folder / "demo.rrd").read_bytes()[:-2000])


def _write_folders(folder: Path, images: Images) -> None:
    for made in (folder / "images", folder / "photos"):
        made.mkdir(parents=True)
    for k, image in enumerate(images):
        cv2.imwrite(str(folder / "images" / f"img{k}.png"), image)
    cv2.imwrite(str(folder / "photo.jpg"), images[0])
    for k in (0, 12):  # larger, as photographs that are moved must be
        cv2.imwrite(str(folder / "photos" / f"{k}.jpg"), cv2.resize(images[k], None, fx=2, fy=2))
    (folder / "drawn").mkdir()
    (folder / "drawn" / "0.txt").write_text("10 20 300 200\n")


def _write_euroc(folder: Path, cameras: dict[str, Images], focal: float) -> None:
    for (name, images), x in zip(cameras.items(), (0.0, 0.12), strict=True):
        (folder / name / "data").mkdir(parents=True)
        (folder / name / "sensor.yaml").write_text(SENSOR.format(f=focal, x=x))
        rows = ["#timestamp [ns],filename\n"]
        for k, image in enumerate(images):
            stamp = EPOCH_NS + k * STEP_NS
            cv2.imwrite(str(folder / name / "data" / f"{stamp}.png"), image)
            rows.append(f"{stamp},{stamp}.png\n")
        (folder / name / "data.csv").write_text("".join(rows))


def _write_log(path: Path, images: Images) -> Path:
    messages = []
    for k, image in enumerate(images):
        stamp_ns = EPOCH_NS + (k * STEP_NS if k < FRAMES // 2 else LATER_NS + (k - FRAMES // 2) * STEP_NS)
        data = cv2.imencode(".jpg", image)[1]
        messages.append(Logged(stamp_ns, cdr("CompressedImage", stamp_ns=stamp_ns, format="jpeg", data=data)))
    kind = "sensor_msgs/msg/CompressedImage"
    definition = ROS2.generate_msgdef(kind, ros_version=2)[0].encode()  # which Rerun needs
    return write_log(path, {"/cam0/image_raw": Channel(kind, "cdr", messages)}, definition=definition)


def _write_bag(path: Path, images: Images) -> None:
    with Writer(path) as bag:
        camera = bag.add_connection("/cam0/image_raw", "sensor_msgs/msg/Image", typestore=ROS1)
        for k, image in enumerate(images):
            stamp_ns = EPOCH_NS + k * STEP_NS
            fields = image_fields(image.tobytes(), *SIZE, "bgr8", 3 * SIZE[0])
            bag.write(camera, stamp_ns, ros1("Image", stamp_ns=stamp_ns, **fields))

"""Camera messages as the standard serialisers write them, and a picture to put into them."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
from rosbags.typesys import Stores, get_typestore

from airline.scenes import RenderedClip
from frontend.sources.scene import SceneSource

ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
STAMP_NS = 1_700_000_000_123_456_789
FRAME = "camera_optical"
K = (500.0, 0.0, 319.5, 0.0, 501.0, 239.5, 0.0, 0.0, 1.0)
R = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
P = (500.0, 0.0, 319.5, -50.0, 0.0, 501.0, 239.5, 0.0, 0.0, 0.0, 1.0, 0.0)
D = (0.1, -0.2, 0.001, 0.002, 0.05)


@cache
def rendered() -> np.ndarray:
    """A rendered corridor, 640x480 BGR."""
    sequence = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=1)
    return next(iter(SceneSource(sequence))).image


@cache
def picture(width: int = 96, height: int = 64) -> np.ndarray:
    """The corridor, smaller, in strong colours."""
    small = cv2.resize(rendered(), (width, height), interpolation=cv2.INTER_AREA)
    hue = np.linspace(0, 360, width, dtype=np.float32)[None].repeat(height, 0)
    light = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.float32) / 255
    hsv = np.dstack([hue, np.full_like(hue, 0.6), 0.25 + 0.7 * light])
    return np.rint(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR) * 255).astype(np.uint8)


def ros(store: Any, kind: str, stamp_ns: int = STAMP_NS, **fields: Any) -> Any:
    """A sensor_msgs message with its header."""
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    number = {"seq": 7} if store is ROS1 else {}
    header = types["std_msgs/msg/Header"](**number, stamp=stamp, frame_id=FRAME)
    return types[f"sensor_msgs/msg/{kind}"](header=header, **fields)


def image_fields(data: bytes, width: int, height: int, encoding: str, step: int, big_endian: bool = False) -> Any:
    """Fields of sensor_msgs/Image."""
    given = {"height": height, "width": width, "encoding": encoding, "step": step}
    return {**given, "is_bigendian": int(big_endian), "data": np.frombuffer(data, np.uint8)}


def info_fields(store: Any) -> Any:
    """Fields of sensor_msgs/CameraInfo, which have capitals in ROS 1."""
    region = {"x_offset": 8, "y_offset": 4, "height": 400, "width": 600, "do_rectify": True}
    arrays = {"d": D, "k": K, "r": R, "p": P}
    return {
        **{name.upper() if store is ROS1 else name: np.array(array) for name, array in arrays.items()},
        **{"height": 480, "width": 640, "distortion_model": "plumb_bob", "binning_x": 2, "binning_y": 1},
        "roi": store.types["sensor_msgs/msg/RegionOfInterest"](**region),
    }


def cdr(kind: str, *, little_endian: bool = True, **fields: Any) -> bytes:
    """A ROS 2 message."""
    message = ros(ROS2, kind, **fields)
    return bytes(ROS2.serialize_cdr(message, f"sensor_msgs/msg/{kind}", little_endian=little_endian))


def ros1(kind: str, **fields: Any) -> bytes:
    """A ROS 1 message."""
    return bytes(ROS1.serialize_ros1(ros(ROS1, kind, **fields), f"sensor_msgs/msg/{kind}"))

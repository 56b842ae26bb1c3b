"""ROS camera messages: sensor_msgs Image, CompressedImage and CameraInfo of ROS 2 (CDR) and ROS 1.

Their layouts are fixed by ROS, so the definitions inside a log, which may be damaged or hostile, are never used.
https://docs.ros.org/en/rolling/p/sensor_msgs/
"""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from logs.messages.annexb import sniffed_video_format, video_format
from logs.messages.types import (
    Bytes,
    CameraInfo,
    EncodedImage,
    RawImage,
    Record,
    UndecodableError,
    VideoPacket,
    stamp_ns,
)

_DEPTH_HEADER = 12  # bytes that compressed_depth_image_transport puts before the image
_PNG = b"\x89PNG"


def deserialise(store: Typestore, type_name: str, encoding: str, data: Bytes) -> Any:
    """A message of a type of the store, in "cdr" or "ros1"; raises UndecodableError: the bytes are no such message."""
    try:
        if encoding == "ros1":
            return store.deserialize_ros1(memoryview(data), type_name)
        return store.deserialize_cdr(memoryview(data), type_name)
    except SerdeError as error:
        raise UndecodableError("damaged message", str(error)) from error


def _record(kind: str, message: Any) -> Record:
    stamp = message.header.stamp
    head = stamp_ns(stamp.sec, stamp.nanosec), message.header.frame_id
    if kind == "CompressedImage":
        return _compressed(head, message.format, message.data.data)
    size = message.width, message.height
    if kind == "Image":
        return RawImage(*head, *size, message.encoding, message.step, bool(message.is_bigendian), message.data.data)
    d, k, r, p = (
        tuple(getattr(message, name if hasattr(message, name) else name.upper()).tolist()) for name in "dkrp"
    )  # capitals in ROS 1
    binning = message.binning_x, message.binning_y
    roi = message.roi.x_offset, message.roi.y_offset, message.roi.width, message.roi.height
    return CameraInfo(*head, *size, message.distortion_model, d, k, r, p, binning, roi)


def _compressed(head: tuple[int, str], text: str, data: memoryview) -> EncodedImage | VideoPacket:
    """An image or video packet, told by the free text beside it and by its first bytes."""
    if "compressedDepth" in text:
        if not text.startswith("16UC1") or data[_DEPTH_HEADER : _DEPTH_HEADER + 4] != _PNG:
            raise UndecodableError("compressed depth is not readable", text[:60])
        return EncodedImage(*head, data[_DEPTH_HEADER:])
    video = video_format(text) or sniffed_video_format(data)
    return VideoPacket(*head, video, data) if video else EncodedImage(*head, data)


_store = cache(get_typestore)


def read(kind: str, encoding: str, data: Bytes) -> Record:
    """A message of "sensor_msgs/<kind>" in "cdr" or "ros1", whose data are views; raises UndecodableError."""
    store = _store(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    return _record(kind, deserialise(store, f"sensor_msgs/msg/{kind}", encoding, data))

"""ROS camera messages: sensor_msgs Image, CompressedImage and CameraInfo of ROS 2 (CDR) and ROS 1.

Their layouts are fixed by ROS, so the definitions inside a log, which may be damaged or hostile, are never used.
https://docs.ros.org/en/rolling/p/sensor_msgs/
"""

from __future__ import annotations

from collections.abc import Callable
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


def read_cdr(store: Typestore, type_name: str, data: Bytes) -> Any:
    """Deserialise one CDR message of a type of the store.

    Raises:
        UndecodableError: the bytes are no such message.
    """
    try:
        return store.deserialize_cdr(memoryview(data), type_name)
    except SerdeError as error:
        raise UndecodableError("damaged message", str(error)) from error


def _read_ros1(store: Typestore, type_name: str, data: Bytes) -> Any:
    try:
        return store.deserialize_ros1(memoryview(data), type_name)
    except SerdeError as error:
        raise UndecodableError("damaged message", str(error)) from error


def _image(message: Any) -> RawImage:
    return RawImage(
        *_header(message),
        message.width,
        message.height,
        message.encoding,
        message.step,
        bool(message.is_bigendian),
        message.data.data,
    )


def _compressed_image(message: Any) -> EncodedImage | VideoPacket:
    data = message.data.data
    if "compressedDepth" in message.format:
        if not message.format.startswith("16UC1") or data[_DEPTH_HEADER : _DEPTH_HEADER + 4] != _PNG:
            raise UndecodableError("compressed depth is not readable", message.format[:60])
        return EncodedImage(*_header(message), data[_DEPTH_HEADER:])
    video = video_format(message.format) or sniffed_video_format(data)
    return VideoPacket(*_header(message), video, data) if video else EncodedImage(*_header(message), data)


def _camera_info(message: Any) -> CameraInfo:
    d, k, r, p = (
        tuple(getattr(message, name if hasattr(message, name) else name.upper()).tolist()) for name in "dkrp"
    )  # capitals in ROS 1
    roi = message.roi
    return CameraInfo(
        *_header(message),
        message.width,
        message.height,
        message.distortion_model,
        d,
        k,
        r,
        p,
        (message.binning_x, message.binning_y),
        (roi.x_offset, roi.y_offset, roi.width, roi.height),
    )


def _header(message: Any) -> tuple[int, str]:
    header = message.header
    return stamp_ns(header.stamp.sec, header.stamp.nanosec), header.frame_id


_RECORDS: dict[str, Callable[[Any], Record]] = {
    "Image": _image,
    "CompressedImage": _compressed_image,
    "CameraInfo": _camera_info,
}
_store = cache(get_typestore)


def reader(name: str, encoding: str) -> Callable[[Bytes], Record]:
    """How to read messages of "sensor_msgs/<type>" in "cdr" or "ros1".

    Returns:
        A function from a message to its record, whose data are views into the message. It raises UndecodableError.
    """
    kind = name.removeprefix("sensor_msgs/")
    record = _RECORDS[kind]
    store = _store(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    deserialise = _read_ros1 if encoding == "ros1" else read_cdr

    def read(data: Bytes) -> Record:
        return record(deserialise(store, f"sensor_msgs/msg/{kind}", data))

    return read

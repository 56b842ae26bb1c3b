"""Which messages are camera images and calibrations, and which of them can be read."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from typing import TYPE_CHECKING

from logs.messages.types import Bytes, Record, UndecodableError

if TYPE_CHECKING:
    from logs.files.types import LogMessage

_IMAGES = {"Image", "RawImage", "CompressedImage", "CompressedVideo", "FFMPEGPacket"}
_CALIBRATIONS = {"CameraInfo", "CameraCalibration"}
_ROS = [f"sensor_msgs/{kind}" for kind in ("Image", "CompressedImage", "CameraInfo")]
_FOXGLOVE = ["RawImage", "CompressedImage", "CompressedVideo", "CameraCalibration"]
_MODULES = {
    **{(name, encoding): "ros" for name in _ROS for encoding in ("cdr", "ros1")},
    **{(f"foxglove.{kind}", encoding): "foxglove" for kind in _FOXGLOVE for encoding in ("protobuf", "json")},
    **{(f"foxglove_msgs/{kind}", "cdr"): "foxglove" for kind in _FOXGLOVE},
}


@cache
def reader_for(schema_name: str, encoding: str) -> Callable[[Bytes], Record] | None:
    """How to read messages of one type; the libraries this takes are imported now.

    Args:
        schema_name: such as "sensor_msgs/msg/Image" (ROS 2), "sensor_msgs/Image" (ROS 1) or "foxglove.RawImage".
        encoding: of the messages: "cdr", "ros1", "protobuf" or "json".

    Returns:
        A function from a message's bytes to its record, for any thread. It raises UndecodableError and nothing else,
        whatever the bytes are. None for types that are not readable here.
    """
    name = schema_name.replace("/msg/", "/")
    module = _MODULES.get((name, encoding))
    if module is None:
        return None
    return partial(import_module(f"logs.messages.{module}").read, re.split("[./]", name)[-1], encoding)


def read_message(message: LogMessage) -> Record:
    """What a message of a log says; raises UndecodableError: it is damaged, or of a type that is not readable."""
    read = reader_for(message.type.schema_name, message.type.encoding)
    if read is None:
        raise UndecodableError("its type is not readable", repr(str(message.type)))
    return read(message.data)


def is_image_type(schema_name: str) -> bool:
    """Whether messages of this type are camera images, readable here or not."""
    return _last(schema_name) in _IMAGES


def is_calibration_type(schema_name: str) -> bool:
    """Whether messages of this type are camera calibrations, readable here or not."""
    return _last(schema_name) in _CALIBRATIONS


def _last(schema_name: str) -> str:
    return re.split(r"[./:]", schema_name)[-1]

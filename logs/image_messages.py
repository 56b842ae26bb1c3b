"""From one message of a log to an image and its time.

ROS 2: https://docs.ros.org/en/rolling/p/sensor_msgs/; Foxglove: https://docs.foxglove.dev/docs/sdk/schemas
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import cv2
import msgspec
import numpy as np
from mcap.records import Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_ros2.decoder import DecoderFactory

from airline.errors import InputError
from frontend.opencv import Image, as_frame_image, decode_image

T = TypeVar("T")
Decoder = Callable[[bytes], tuple[int, Image]]

# The layouts are fixed by ROS, so the schema text inside the log, which may be IDL or damaged, is not needed.
_HEADER = """std_msgs/Header header
{fields}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
_ROS2_FIELDS = {
    "sensor_msgs/msg/Image": """uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data""",
    "sensor_msgs/msg/CompressedImage": "string format\nuint8[] data",
}
# Per encoding: bytes per channel, channels, and OpenCV's conversion to BGR where one is needed.
_PIXELS: dict[str, tuple[int, int, int | None]] = {
    "mono8": (1, 1, None),
    "8UC1": (1, 1, None),
    "mono16": (2, 1, None),
    "16UC1": (2, 1, None),
    "bgr8": (1, 3, None),
    "8UC3": (1, 3, None),
    "rgb8": (1, 3, cv2.COLOR_RGB2BGR),
    "bgra8": (1, 4, cv2.COLOR_BGRA2BGR),
    "rgba8": (1, 4, cv2.COLOR_RGBA2BGR),
}


class _FoxgloveTime(msgspec.Struct):
    sec: int
    nsec: int


class _FoxgloveRawImage(msgspec.Struct):
    timestamp: _FoxgloveTime
    width: int
    height: int
    encoding: str
    step: int
    data: bytes  # msgspec decodes the base64


class _FoxgloveCompressedImage(msgspec.Struct):
    timestamp: _FoxgloveTime
    data: bytes


def is_image_type(schema_name: str) -> bool:
    """Whether messages of this type are camera images, readable here or not."""
    return re.split(r"[./]", schema_name)[-1] in ("Image", "RawImage", "CompressedImage", "CompressedVideo")


def decoder_for(schema_name: str, message_encoding: str) -> Decoder | None:
    """How to read messages of one type.

    Returns:
        A function from a message's bytes to (stamp in ns, image); it raises InputError, which says what is wrong with
        the message. None for types that are not readable here.
    """
    if message_encoding == MessageEncoding.CDR and schema_name in _ROS2_FIELDS:
        return _ros2_compressed_image if schema_name.endswith("CompressedImage") else _ros2_image
    if message_encoding == MessageEncoding.JSON:
        return {"foxglove.RawImage": _foxglove_raw, "foxglove.CompressedImage": _foxglove_compressed}.get(schema_name)
    return None


def image_from_pixels(data: bytes, width: int, height: int, encoding: str, step: int, big_endian: bool) -> Image:
    """The image in a raw image message.

    Args:
        data: rows of `step` bytes, of which the pixels are the first; the last row may end with its pixels.
        encoding: a ROS encoding; see `_PIXELS`.
        step: bytes from one row to the next; 0 for rows without padding.

    Raises:
        InputError: an encoding that is not readable, or sizes that contradict each other.
    """
    if encoding not in _PIXELS:
        raise InputError(f"image encoding {encoding[:40]!r} is not readable yet")
    depth, channels, conversion = _PIXELS[encoding]
    row = width * channels * depth
    step = step or row
    if width < 1 or height < 1 or step < row or (height - 1) * step + row > len(data):
        raise InputError(f"{len(data)} bytes are no {width}x{height} {encoding} image with {step} bytes per row")
    pixels = np.ndarray(
        (height, width, channels),
        np.dtype(np.uint8 if depth == 1 else np.uint16).newbyteorder(">" if big_endian else "<"),
        data,
        strides=(step, channels * depth, depth),
    )
    # A copy either way, as a message's bytes are read-only.
    bgr = pixels.astype(pixels.dtype.newbyteorder("=")) if conversion is None else cv2.cvtColor(pixels, conversion)
    image = as_frame_image(bgr)
    assert image is not None  # sizes and depth were checked above
    return image


@cache
def _ros2_decoder(schema_name: str) -> Callable[[bytes], Any]:
    text = _HEADER.format(fields=_ROS2_FIELDS[schema_name])
    schema = Schema(id=1, name=schema_name, encoding=SchemaEncoding.ROS2, data=text.encode())
    decoder = DecoderFactory().decoder_for(MessageEncoding.CDR, schema)
    assert decoder is not None
    return decoder


def _ros2(schema_name: str, data: bytes) -> Any:
    try:
        return _ros2_decoder(schema_name)(data)
    except (struct.error, ValueError) as error:
        raise InputError(f"the message is damaged ({error})") from error


def _ros2_image(data: bytes) -> tuple[int, Image]:
    message = _ros2("sensor_msgs/msg/Image", data)
    return _stamp(message.header.stamp.sec, message.header.stamp.nanosec), image_from_pixels(
        message.data, message.width, message.height, message.encoding, message.step, bool(message.is_bigendian)
    )


def _ros2_compressed_image(data: bytes) -> tuple[int, Image]:
    message = _ros2("sensor_msgs/msg/CompressedImage", data)
    return _stamp(message.header.stamp.sec, message.header.stamp.nanosec), _decoded(message.data)


def _foxglove_raw(data: bytes) -> tuple[int, Image]:
    message = _json(data, _FoxgloveRawImage)
    image = image_from_pixels(message.data, message.width, message.height, message.encoding, message.step, False)
    return _stamp(message.timestamp.sec, message.timestamp.nsec), image


def _foxglove_compressed(data: bytes) -> tuple[int, Image]:
    message = _json(data, _FoxgloveCompressedImage)
    return _stamp(message.timestamp.sec, message.timestamp.nsec), _decoded(message.data)


def _json(data: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"the message is damaged ({error})") from error


def _stamp(seconds: int, nanoseconds: int) -> int:
    stamp = seconds * 10**9 + nanoseconds
    if not 0 <= stamp < 2**63:
        raise InputError(f"{seconds} s is no time")
    return stamp


def _decoded(data: bytes) -> Image:
    """The encoded image, by its bytes: the format field is free text."""
    image = decode_image(data)
    if image is None:
        raise InputError(f"{len(data)} bytes are no image that can be decoded")
    return image

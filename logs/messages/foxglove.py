"""Foxglove's camera messages in protobuf, JSON and ROS 2 CDR.

The schemas are those of https://docs.foxglove.dev/docs/sdk/schemas. Fields that newer versions add are passed over in
protobuf and JSON; CDR has no room for them.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any

import msgspec
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage as ProtobufRawImage
from google.protobuf.message import DecodeError, Message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from logs.messages.annexb import video_format
from logs.messages.ros import deserialise
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

_Uint32 = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]


class _JsonTime(msgspec.Struct):
    sec: int
    nsec: int


class _JsonMessage(msgspec.Struct, kw_only=True):
    timestamp: _JsonTime
    frame_id: str = ""


class _JsonRawImage(_JsonMessage, kw_only=True):
    width: _Uint32
    height: _Uint32
    encoding: str
    step: _Uint32
    data: bytes  # msgspec decodes the base64


class _JsonCompressed(_JsonMessage, kw_only=True):
    data: bytes
    format: str = ""


class _JsonCalibration(_JsonMessage, kw_only=True):
    width: _Uint32
    height: _Uint32
    distortion_model: str = ""
    D: list[float] = []
    K: list[float]
    R: list[float] = []
    P: list[float] = []


# How each type is written down in each encoding.
_TYPES: dict[str, tuple[type[Message], type[_JsonMessage], str]] = {
    "RawImage": (
        ProtobufRawImage,
        _JsonRawImage,
        "uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data",
    ),
    "CompressedImage": (CompressedImage, _JsonCompressed, "uint8[] data\nstring format"),
    "CompressedVideo": (CompressedVideo, _JsonCompressed, "uint8[] data\nstring format"),
    "CameraCalibration": (
        CameraCalibration,
        _JsonCalibration,
        "uint32 width\nuint32 height\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p",
    ),
}


def _record(kind: str, message: Any, stamp: int) -> Record:
    head = stamp, message.frame_id
    if kind == "CameraCalibration":
        capital = hasattr(message, "K")  # small letters in ROS 2
        d, k, r, p = (tuple(map(float, getattr(message, name.upper() if capital else name))) for name in "dkrp")
        r = r or (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        p = p or (*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0)
        if (len(k), len(r), len(p)) != (9, 9, 12):
            raise UndecodableError("damaged message", "K, R and P have 9, 9 and 12 numbers")
        return CameraInfo(*head, message.width, message.height, message.distortion_model, d, k, r, p)
    data = message.data if isinstance(message.data, bytes) else message.data.data  # an array in CDR
    if kind == "RawImage":
        return RawImage(*head, message.width, message.height, message.encoding, message.step, False, data)
    if kind == "CompressedImage":
        return EncodedImage(*head, data)
    coding = video_format(message.format)
    if coding is None:
        raise UndecodableError("video format is not readable", message.format[:40])
    return VideoPacket(*head, coding, data)


def read(kind: str, encoding: str, data: Bytes) -> Record:
    """A message of "foxglove.<kind>" in "protobuf" or "json", or of "foxglove_msgs/<kind>" in "cdr".

    Raises:
        UndecodableError: the bytes are no such message.
    """
    protobuf, json, _ = _TYPES[kind]
    message: Any
    if encoding == "cdr":
        message = deserialise(_cdr_store(), f"foxglove_msgs/msg/{kind}", "cdr", data)
        return _record(kind, message, stamp_ns(message.timestamp.sec, message.timestamp.nanosec))
    try:
        if encoding == "json":
            message = msgspec.json.decode(data, type=json)
            return _record(kind, message, stamp_ns(message.timestamp.sec, message.timestamp.nsec))
        message = protobuf()
        message.ParseFromString(data)
        return _record(kind, message, stamp_ns(message.timestamp.seconds, message.timestamp.nanos))
    except (DecodeError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise UndecodableError("damaged message", str(error)) from error


@cache
def _cdr_store() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, (_, _, fields) in _TYPES.items():
        text = f"builtin_interfaces/Time timestamp\nstring frame_id\n{fields}\n"
        store.register(get_types_from_msg(text, f"foxglove_msgs/msg/{kind}"))
    return store

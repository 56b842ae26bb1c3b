"""Camera messages of ROS and Foxglove: which ones can be read, and what they say.

ROS: sensor_msgs in CDR (ROS 2) and ROS 1's own encoding, https://docs.ros.org/en/rolling/p/sensor_msgs/.
Foxglove: protobuf, JSON and CDR, https://docs.foxglove.dev/docs/sdk/schemas. Fields that newer versions add are passed
over in protobuf and JSON; CDR has no room for them. The layouts are fixed, so the definitions inside a log, which may
be damaged or hostile, are never used.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage as ProtobufRawImage
from google.protobuf.message import DecodeError, Message
from google.protobuf.timestamp_pb2 import Timestamp
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from frontend.sources.reading import Bytes, UndecodableError
from logs.messages.compression import unzipped
from logs.messages.types import (
    BAYER,
    UNKNOWN_FILE,
    VIDEO_FORMATS,
    CameraInfo,
    EncodedImage,
    RawImage,
    Record,
    VideoPacket,
    container,
    sniffed_video_format,
    stamp_ns,
    video_format,
)

if TYPE_CHECKING:
    from logs.files import LogMessage

_DISPARITY = "DisparityImage"
_IMAGES = {"Image", "RawImage", "CompressedImage", "CompressedVideo", "FFMPEGPacket", _DISPARITY}
_CALIBRATIONS = {"CameraInfo", "CameraCalibration"}
# Text that image_transport and others put into CompressedImage.format: "bayer_rggb8; jpeg compressed ". What the file
# holds stands last, if it was converted: "bayer_rggb8; jpeg compressed bgr8".
_ENCODING = re.compile(
    r"\b(?:bayer_?[rgb]{2,4}\d*p?|(?:mono|rgba?|bgra?)(?:8|16)|(?:8|16|32|64)[USF]C[1-4])\b", re.IGNORECASE
)
# ROS names the four pixels, GenICam the first two: BayerRG12p. What is in a file has 8 or 16 bits.
_MOSAIC = re.compile(r"bayer_?(rg|bg|gb|gr)[rgb]{0,2}(\d*)p?", re.IGNORECASE)
_ROWS = {"rg": "rggb", "bg": "bggr", "gb": "gbrg", "gr": "grbg"}
_PNG_16_BIT = re.compile(rb"\x89PNG.{20}\x10[\0\4]", re.DOTALL)  # grey
_SEEN = {
    "left",
    "right",
    "color",
    "colour",
    "rgb",
    "ir",
    "infra",
    "infrared",
    "mono",
    "intensity",
    "amplitude",
    "thermal",
    "confidence",
}
_LONGEST_FORMAT = 200
_FLOATS = ("32FC1", "64FC1")
_Uint32 = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]


class _JsonTime(msgspec.Struct, rename={"nanosec": "nsec"}):
    sec: int
    nanosec: int


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


_RAW = "uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data"
_COMPRESSED = "uint8[] data\nstring format"
_CALIBRATION = (
    "uint32 width\nuint32 height\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p"
)
# How each of Foxglove's types is written down in protobuf, JSON and CDR.
_FOXGLOVE: dict[str, tuple[type[Message], type[_JsonMessage], str]] = {
    "RawImage": (ProtobufRawImage, _JsonRawImage, _RAW),
    "CompressedImage": (CompressedImage, _JsonCompressed, _COMPRESSED),
    "CompressedVideo": (CompressedVideo, _JsonCompressed, _COMPRESSED),
    "CameraCalibration": (CameraCalibration, _JsonCalibration, _CALIBRATION),
}
_READABLE = {
    "sensor_msgs/": (("cdr", "ros1"), ("Image", "CompressedImage", "CameraInfo")),
    "foxglove_msgs/": (("cdr",), _FOXGLOVE),
    "foxglove.": (("protobuf", "json"), _FOXGLOVE),
}


@cache
def reader_for(schema_name: str, encoding: str) -> Callable[[Bytes], Record] | None:
    """How to read messages of one type; None for types that are not readable here.

    Args:
        schema_name: such as "sensor_msgs/msg/Image" (ROS 2), "sensor_msgs/Image" (ROS 1) or "foxglove.RawImage".
        encoding: of the messages: "cdr", "ros1", "protobuf" or "json".

    Returns:
        A function from a message's bytes to its record, for any thread. It raises UndecodableError and nothing else,
        whatever the bytes are.
    """
    name = schema_name.replace("/msg/", "/")
    kind = _last(name)
    package = name.removesuffix(kind)
    encodings, kinds = _READABLE.get(package, ((), ()))
    return partial(_read, package, kind, encoding) if encoding in encodings and kind in kinds else None


def read_message(message: LogMessage) -> Record:
    """What a message of a log says; raises UndecodableError: it is damaged, or of a type that is not readable."""
    if is_disparity_type(message.type.schema_name):
        raise DepthError(_DISPARITY)
    read = reader_for(message.type.schema_name, message.type.encoding)
    if read is None:
        raise UndecodableError("its type is not readable", repr(str(message.type)))
    return read(message.data)


class DepthError(UndecodableError):
    """A message holds distances or disparities, not a picture."""

    def __init__(self, detail: str) -> None:
        super().__init__("depth is measured, not seen", detail)


def check_seen(record: Record, topic: str) -> None:
    """Raises DepthError: the record is depth: floats, or 16 bits on a topic whose name says so.

    Names are read from their end: `/depth_camera/ir` is none. Of disparity 8 bits are refused, too.
    """
    if isinstance(record, RawImage):
        encoding = record.encoding
    elif isinstance(record, EncodedImage):
        encoding = record.encoding or ("mono16" if _PNG_16_BIT.match(record.data) else "")
    else:
        return
    if isinstance(record, EncodedImage) and topic.lower().endswith("/compresseddepth"):
        raise DepthError(encoding)
    named = depth_word(topic, encoding)
    grey = ("16UC1", "mono16", *(("mono8", "8UC1") if named == "disparity" else ()))
    if encoding in _FLOATS or (named is not None and encoding in grey):
        raise DepthError(encoding)


def depth_word(topic: str, encoding: str = "16UC1") -> str | None:
    """What a topic's name says that images of an encoding are: "depth", "disparity", or neither."""
    for part in reversed(topic.lower().split("/")):
        words = re.split("[^a-z]+", part)
        if "disparity" in words:
            return "disparity"
        if any(word.startswith("depth") or word in ("range", "rgbd") for word in words):
            return "depth"
        if "stereo" in words and encoding == "16UC1":  # DepthAI
            return "depth"
        if not _SEEN.isdisjoint(words):
            return None
    return None


def is_image_type(schema_name: str) -> bool:
    """Whether messages of this type are camera images, readable here or not."""
    return _last(schema_name) in _IMAGES


def is_disparity_type(schema_name: str) -> bool:
    """Whether messages of this type are measured distances by their type alone."""
    return _last(schema_name) == _DISPARITY


def is_calibration_type(schema_name: str) -> bool:
    """Whether messages of this type are camera calibrations, readable here or not."""
    return _last(schema_name) in _CALIBRATIONS


def _last(schema_name: str) -> str:
    return re.split(r"[./:]", schema_name)[-1]


def _read(package: str, kind: str, encoding: str, data: Bytes) -> Record:
    message: Any
    try:
        if encoding == "cdr":
            data = unzipped(data)
        if encoding == "json":
            message = msgspec.json.decode(data, type=_FOXGLOVE[kind][1])
        elif encoding == "protobuf":
            message = _FOXGLOVE[kind][0]()
            message.ParseFromString(data)
        elif encoding == "ros1":
            message = _ros1().deserialize_ros1(memoryview(data), f"{package}msg/{kind}")
        else:
            message = _ros2().deserialize_cdr(memoryview(data), f"{package}msg/{kind}")
        return _record(kind, message)
    except (SerdeError, DecodeError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise UndecodableError("damaged message", str(error)) from error


def _record(kind: str, message: Any) -> Record:
    header = getattr(message, "header", None)  # ROS
    stamp, frame_id = (message.timestamp, message.frame_id) if header is None else (header.stamp, header.frame_id)
    time = (stamp.seconds, stamp.nanos) if isinstance(stamp, Timestamp) else (stamp.sec, stamp.nanosec)
    head = stamp_ns(*time), frame_id
    if kind in _CALIBRATIONS:
        return _camera_info(head, message)
    data = message.data if isinstance(message.data, bytes) else message.data.data  # an array in ROS and CDR
    if kind in ("Image", "RawImage"):
        big_endian = bool(getattr(message, "is_bigendian", False))
        return RawImage(*head, message.width, message.height, message.encoding, message.step, big_endian, data)
    text = message.format
    if kind == "CompressedVideo":
        video = video_format(text)
        if video is None:
            raise UndecodableError("video format is not readable", f"{text[:40]!r}, only {', '.join(VIDEO_FORMATS)}")
        return VideoPacket(*head, video, data)
    if header is not None and "compresseddepth" in text.lower():
        raise DepthError(text[:60].strip())
    is_file = container(data) != UNKNOWN_FILE
    if header is not None and not is_file and (video := video_format(text) or sniffed_video_format(data)):
        return VideoPacket(*head, video, data)
    named = _ENCODING.findall(text[:_LONGEST_FORMAT])
    inside = named[-1] if named else ""
    if mosaic := _MOSAIC.fullmatch(inside):
        inside = f"bayer_{_ROWS[mosaic[1].lower()]}{16 if mosaic[2] == '16' else 8}"
    known = (*BAYER, "16UC1", *_FLOATS)
    return EncodedImage(*head, data, next((name for name in known if name.lower() == inside.lower()), ""))


def _camera_info(head: tuple[int, str], message: Any) -> CameraInfo:
    capital = hasattr(message, "K")  # small letters in ROS 2
    d, k, r, p = (tuple(map(float, getattr(message, name.upper() if capital else name))) for name in "dkrp")
    r = r or (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    p = p or (*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0)
    if (len(k), len(r), len(p)) != (9, 9, 12):
        raise UndecodableError("damaged message", "K, R and P have 9, 9 and 12 numbers")
    info = CameraInfo(*head, message.width, message.height, message.distortion_model, d, k, r, p)
    if not hasattr(message, "roi"):
        return info
    roi = message.roi.x_offset, message.roi.y_offset, message.roi.width, message.roi.height
    return replace(info, binning=(message.binning_x, message.binning_y), roi=roi)


@cache
def _ros1() -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC)


@cache
def _ros2() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, (_, _, fields) in _FOXGLOVE.items():
        text = f"builtin_interfaces/Time timestamp\nstring frame_id\n{fields}\n"
        store.register(get_types_from_msg(text, f"foxglove_msgs/msg/{kind}"))
    return store

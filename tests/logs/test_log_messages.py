"""Camera messages of ROS and Foxglove to records: every type and encoding, hostile bytes."""

from __future__ import annotations

import base64
import json
import tracemalloc
from typing import Any

import numpy as np
import pytest
import zstandard
from foxglove_schemas_protobuf import CameraCalibration_pb2, CompressedImage_pb2, CompressedVideo_pb2, RawImage_pb2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from frontend.sources.reading import UndecodableError
from logs.messages.readers import DepthError, check_seen, is_calibration_type, is_image_type, reader_for
from logs.messages.types import CameraInfo, EncodedImage, RawImage, Record, VideoPacket
from tests.helpers.camera_messages import FRAME, ROS1, ROS2, STAMP_NS, D, K, P, R, cdr, image_fields, info_fields, ros1

PIXELS = bytes(range(24))
IMAGE = image_fields(PIXELS, 4, 2, "rgb8", 12)
SEC, NSEC = divmod(STAMP_NS, 10**9)
IDR = b"\0\0\0\1\x67\x42\0\0\1\x65\x88"
IDR_H265 = b"\0\0\0\1\x40\1\x0c"
UNPADDED_P = (*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0)


def read(schema: str, encoding: str, data: bytes) -> Record:
    reader = reader_for(schema, encoding)
    assert reader is not None
    record = reader(data)
    assert reader(memoryview(data)) == record
    return record


def protobuf(message: Any, **fields: Any) -> bytes:
    filled = message(frame_id=FRAME, **fields)
    filled.timestamp.seconds, filled.timestamp.nanos = SEC, NSEC
    return bytes(filled.SerializeToString())


def as_json(**fields: Any) -> bytes:
    fields = {name: base64.b64encode(x).decode() if isinstance(x, bytes) else x for name, x in fields.items()}
    return json.dumps({"timestamp": {"sec": SEC, "nsec": NSEC}, "frame_id": FRAME, **fields}).encode()


def foxglove_cdr(kind: str, definition: str, **fields: Any) -> bytes:
    store = get_typestore(Stores.ROS2_HUMBLE)
    name = f"foxglove_msgs/msg/{kind}"
    store.register(get_types_from_msg("builtin_interfaces/Time timestamp\nstring frame_id\n" + definition, name))
    stamp = store.types["builtin_interfaces/msg/Time"](sec=SEC, nanosec=NSEC)
    return bytes(store.serialize_cdr(store.types[name](timestamp=stamp, frame_id=FRAME, **fields), name))


def array(data: bytes) -> np.ndarray:
    return np.frombuffer(data, np.uint8)


RAW = {"width": 4, "height": 2, "encoding": "rgb8", "step": 12}
CALIBRATION = {"width": 640, "height": 480, "distortion_model": "plumb_bob"}
CAPITALS = {"D": D, "K": K, "R": R, "P": P}
SMALL = {name.lower(): np.array(numbers) for name, numbers in CAPITALS.items()}
CALIBRATION_DEFINITION = (
    "uint32 width\nuint32 height\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p"
)
RAW_DEFINITION = "uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data"
ENCODED_DEFINITION = "uint8[] data\nstring format"

MESSAGES: dict[tuple[str, str], bytes] = {
    ("sensor_msgs/msg/Image", "cdr"): cdr("Image", **IMAGE),
    ("sensor_msgs/Image", "ros1"): ros1("Image", **IMAGE),
    ("sensor_msgs/msg/CompressedImage", "cdr"): cdr("CompressedImage", format="jpeg", data=array(PIXELS)),
    ("sensor_msgs/CompressedImage", "ros1"): ros1("CompressedImage", format="jpeg", data=array(PIXELS)),
    ("sensor_msgs/msg/CameraInfo", "cdr"): cdr("CameraInfo", **info_fields(ROS2)),
    ("sensor_msgs/CameraInfo", "ros1"): ros1("CameraInfo", **info_fields(ROS1)),
    ("foxglove.RawImage", "protobuf"): protobuf(RawImage_pb2.RawImage, **RAW, data=PIXELS),
    ("foxglove.RawImage", "json"): as_json(**RAW, data=PIXELS),
    ("foxglove_msgs/msg/RawImage", "cdr"): foxglove_cdr("RawImage", RAW_DEFINITION, **RAW, data=array(PIXELS)),
    ("foxglove.CompressedImage", "protobuf"): protobuf(CompressedImage_pb2.CompressedImage, format="png", data=PIXELS),
    ("foxglove.CompressedImage", "json"): as_json(format="png", data=PIXELS),
    ("foxglove_msgs/msg/CompressedImage", "cdr"): foxglove_cdr(
        "CompressedImage", ENCODED_DEFINITION, format="png", data=array(PIXELS)
    ),
    ("foxglove.CompressedVideo", "protobuf"): protobuf(CompressedVideo_pb2.CompressedVideo, format="h265", data=PIXELS),
    ("foxglove.CompressedVideo", "json"): as_json(format="h265", data=PIXELS),
    ("foxglove_msgs/msg/CompressedVideo", "cdr"): foxglove_cdr(
        "CompressedVideo", ENCODED_DEFINITION, format="h265", data=array(PIXELS)
    ),
    ("foxglove.CameraCalibration", "protobuf"): protobuf(
        CameraCalibration_pb2.CameraCalibration, **CALIBRATION, **CAPITALS
    ),
    ("foxglove.CameraCalibration", "json"): as_json(**CALIBRATION, **CAPITALS),
    ("foxglove_msgs/msg/CameraCalibration", "cdr"): foxglove_cdr(
        "CameraCalibration", CALIBRATION_DEFINITION, **CALIBRATION, **SMALL
    ),
}


def expected(schema: str) -> Record:
    kind = schema.replace("/", ".").split(".")[-1]
    if kind in ("Image", "RawImage"):
        return RawImage(STAMP_NS, FRAME, 4, 2, "rgb8", 12, False, PIXELS)
    if kind == "CompressedImage":
        return EncodedImage(STAMP_NS, FRAME, PIXELS)
    if kind == "CompressedVideo":
        return VideoPacket(STAMP_NS, FRAME, "h265", PIXELS)
    ros_only = ((2, 1), (8, 4, 600, 400)) if kind == "CameraInfo" else ()
    return CameraInfo(STAMP_NS, FRAME, 640, 480, "plumb_bob", D, K, R, P, *ros_only)


@pytest.mark.parametrize(("schema", "encoding"), MESSAGES)
def test_every_type_reads_back(schema: str, encoding: str) -> None:
    assert read(schema, encoding, MESSAGES[schema, encoding]) == expected(schema)
    assert is_calibration_type(schema) == isinstance(expected(schema), CameraInfo) != is_image_type(schema)


def test_other_types() -> None:
    for schema in ("sensor_msgs/msg/PointCloud2", "std_msgs/msg/String", "", "foxglove.CompressedImages"):
        assert not is_image_type(schema)
        assert not is_calibration_type(schema)
        assert reader_for(schema, "cdr") is None
    for schema in ("ffmpeg_image_transport_msgs/msg/FFMPEGPacket", "foxglove::RawImage", "vendor_msgs/msg/Image"):
        assert is_image_type(schema)
        assert reader_for(schema, "cdr") is None
    assert reader_for("foxglove.RawImage", "flatbuffer") is None
    assert reader_for("sensor_msgs/msg/Image", "protobuf") is None


def test_big_endian_cdr() -> None:
    for kind, fields in (("Image", IMAGE), ("CameraInfo", info_fields(ROS2))):
        assert read(f"sensor_msgs/msg/{kind}", "cdr", cdr(kind, little_endian=False, **fields)) == expected(kind)


def test_fields_of_newer_schemas_are_passed_over() -> None:
    field_99 = b"\x9a\x06\x03abc"
    newer = MESSAGES["foxglove.RawImage", "protobuf"] + field_99
    assert read("foxglove.RawImage", "protobuf", newer) == expected("RawImage")
    newer = as_json(**RAW, data=PIXELS, is_bigendian=False, extra={"deep": [[1]]})
    assert read("foxglove.RawImage", "json", newer) == expected("RawImage")


def test_calibration_without_rectification() -> None:
    for data in (
        protobuf(CameraCalibration_pb2.CameraCalibration, **CALIBRATION, D=D, K=K),
        as_json(**CALIBRATION, D=D, K=K),
    ):
        encoding = "json" if data[:1] == b"{" else "protobuf"
        info = read("foxglove.CameraCalibration", encoding, data)
        assert isinstance(info, CameraInfo)
        assert (info.d, info.k, info.r, info.p) == (D, K, R, UNPADDED_P)
    with pytest.raises(UndecodableError, match="9, 9 and 12"):
        read("foxglove.CameraCalibration", "json", as_json(**CALIBRATION, K=K[:8]))


@pytest.mark.parametrize(
    ("text", "data", "found"),
    [
        ("h264", PIXELS, "h264"),
        ("video/HEVC", PIXELS, "h265"),
        ("H.265", PIXELS, "h265"),
        ("", IDR, "h264"),
        ("jpeg", IDR[1:], "h264"),
        ("", b"\0\0\1\x06\x01\x01", "h264"),  # timing, then a picture
        ("", b"\0\0\1\x09\xf0", "h264"),
        ("", IDR_H265, "h265"),
        ("", b"\0\0\1\x26\x01\xaf", "h265"),
        ("", b"\0\0\1\x02\x01\xd0", "h265"),
        ("", b"\0\0\1\x41\x9a\x24", "h264"),
        ("", b"\0\0\1\x68\xce\x38", "h264"),
        ("rgb8; jpeg compressed bgr8", b"\xff\xd8\xff\xe0", None),
        ("", b"\0\0\0\0\0\1\x67\x42", None),
        ("", b"\0\0\1", None),
        ("", b"", None),
    ],
)
def test_video_in_compressed_images(text: str, data: bytes, found: str | None) -> None:
    record = read("sensor_msgs/msg/CompressedImage", "cdr", cdr("CompressedImage", format=text, data=array(data)))
    if found is None:
        assert record == EncodedImage(STAMP_NS, FRAME, data)
    else:
        assert record == VideoPacket(STAMP_NS, FRAME, found, data)


def test_video_formats_of_foxglove() -> None:
    for name, found in (("vp9", "vp9"), ("av1", "av1"), ("AV01", "av1"), ("avc1", "h264")):
        record = read("foxglove.CompressedVideo", "json", as_json(format=name, data=IDR))
        assert record == VideoPacket(STAMP_NS, FRAME, found, IDR)
    for name in ("theora", "mpeg5", "", "x" * 1000):
        with pytest.raises(UndecodableError) as caught:
            read("foxglove.CompressedVideo", "json", as_json(format=name, data=IDR))
        assert caught.value.reason == "video format is not readable"
        assert len(str(caught.value)) < 130


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("bayer_rggb8; jpeg compressed ", "bayer_rggb8"),
        ("BAYER_GRBG16; png compressed", "bayer_grbg16"),
        ("bayer_rggb8; jpeg compressed bgr8", ""),
        ("bayer_rggb8; jpeg compressed mono8", ""),
        ("16UC1; png compressed ", "16UC1"),
        ("32fc1; png compressed", "32FC1"),
        ("mono16; png compressed mono16", ""),
        ("rgb8; jpeg compressed bgr8", ""),
        ("jpeg", ""),
        ("bayer_rggb8" * 10**6, ""),
    ],
)
def test_the_encoding_inside_a_compressed_image(text: str, encoding: str) -> None:
    data = cdr("CompressedImage", format=text, data=array(PIXELS))
    assert read("sensor_msgs/msg/CompressedImage", "cdr", data) == EncodedImage(STAMP_NS, FRAME, PIXELS, encoding)


def test_compressed_depth_is_named() -> None:
    for text, data in (
        ("16UC1; compressedDepth png", bytes(12) + b"\x89PNG\r\n\x1a\n..."),
        ("32FC1; compressedDepth png", bytes(40)),
        ("16UC1; compressedDepth rvl", bytes(40)),
    ):
        with pytest.raises(DepthError) as caught:
            read("sensor_msgs/msg/CompressedImage", "cdr", cdr("CompressedImage", format=text, data=array(data)))
        assert caught.value.reason == "depth is measured, not seen"


@pytest.mark.parametrize(
    ("topic", "encoding", "seen"),
    [
        ("/camera/depth/image_rect_raw", "16UC1", False),
        ("/camera/depth/image_rect_raw", "mono16", False),
        ("/camera/aligned_depth_to_color/image_raw/compressed", "16UC1", False),
        ("/stereo/disparity", "mono8", False),
        ("/thermal", "32FC1", False),
        ("/camera/depth/image_rect_raw", "bgr8", True),
        ("/camera/depth/image_rect_raw", "mono8", True),
        ("/depth_camera/ir/image_raw", "mono16", True),
        ("/depth/infra1/image", "16UC1", True),
        ("/depthai/left", "16UC1", True),
        ("/thermal/image_raw", "16UC1", True),
    ],
)
def test_what_is_depth(topic: str, encoding: str, seen: bool) -> None:
    record = RawImage(0, "", 1, 1, encoding, 0, False, bytes(16))
    if seen:
        check_seen(record, topic)
    else:
        with pytest.raises(DepthError):
            check_seen(record, topic)


@pytest.mark.parametrize("options", [{}, {"write_content_size": False}])
def test_messages_that_were_compressed(options: dict[str, bool]) -> None:
    message = MESSAGES["sensor_msgs/msg/Image", "cdr"]
    packed = zstandard.ZstdCompressor(**options).compress(message)
    assert read("sensor_msgs/msg/Image", "cdr", packed) == expected("Image")
    for cut in range(len(packed)):
        with pytest.raises(UndecodableError):
            read("sensor_msgs/msg/Image", "cdr", packed[:cut])


def test_compressed_bombs_fill_no_memory() -> None:
    for options in ({}, {"write_content_size": False}):
        bomb = zstandard.ZstdCompressor(level=19, **options).compress(bytes(300 << 20))
        tracemalloc.start()
        with pytest.raises(UndecodableError):
            read("sensor_msgs/msg/Image", "cdr", bomb)
        assert tracemalloc.get_traced_memory()[1] < (280 << 20 if options else 16 << 20)
        tracemalloc.stop()


@pytest.mark.parametrize(("sec", "stamp"), [(0, 5), (-3, -3 * 10**9 + 5), (2**40, 0), (-(2**62), 0), (10**50, 0)])
def test_odd_stamps(sec: int, stamp: int) -> None:
    data = json.dumps({"timestamp": {"sec": sec, "nsec": 5}, "data": ""}).encode()
    assert read("foxglove.CompressedImage", "json", data) == EncodedImage(stamp, "", b"")


@pytest.mark.parametrize("number", ["-1", "4294967296", "9" * 5000, "1.5", "1e400", "NaN", "true", '"4"', "null"])
def test_numbers_out_of_range(number: str) -> None:
    data = as_json(**CALIBRATION, K=K).replace(b"640", number.encode())
    with pytest.raises(UndecodableError, match="damaged message"):
        read("foxglove.CameraCalibration", "json", data)


def test_deep_json() -> None:
    deep = b'{"timestamp":' + b"[" * 100_000
    with pytest.raises(UndecodableError):
        read("foxglove.RawImage", "json", deep)
    with pytest.raises(UndecodableError):
        read("foxglove.RawImage", "json", b'{"other":' + b'{"a":' * 100_000)

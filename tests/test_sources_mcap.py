"""MCAP logs: every readable encoding, several topics, and cut, damaged and hostile files."""

from __future__ import annotations

import base64
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from mcap_ros2.writer import Writer as Ros2Writer

from airline.errors import InputError
from frontend.protocols import Source
from logs import McapSource
from logs.image_messages import decoder_for, image_from_pixels

DATA = Path(__file__).parents[2] / "shared" / "data"
COUNT = 12
STEP_NS = 100_000_000
EPOCH_NS = 1_700_000_000_000_000_001

HEADER = """std_msgs/Header header
{}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE = HEADER.format("uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data")
COMPRESSED = HEADER.format("string format\nuint8[] data")


def drawn(number: int) -> np.ndarray:
    image = np.random.default_rng(number).integers(0, 256, (6, 8, 3), np.uint8)
    image[0, 0] = number
    return image


def header(stamp_ns: int) -> dict[str, Any]:
    return {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}, "frame_id": "camera"}


def raw(image: np.ndarray, encoding: str, stamp_ns: int, padding: int = 0, big_endian: bool = False) -> dict[str, Any]:
    pixels = image.astype(image.dtype.newbyteorder(">" if big_endian else "<"))
    rows = [row.tobytes() + b"\xee" * padding for row in pixels]
    return {
        "header": header(stamp_ns),
        "height": image.shape[0],
        "width": image.shape[1],
        "encoding": encoding,
        "is_bigendian": int(big_endian),
        "step": len(rows[0]),
        "data": b"".join(rows),
    }


def compressed(image: np.ndarray, suffix: str, stamp_ns: int) -> dict[str, Any]:
    data = cv2.imencode(suffix, image)[1].tobytes()
    return {"header": header(stamp_ns), "format": "whatever; it is free text", "data": data}


def write_ros2(path: Path, topics: dict[str, list[dict[str, Any]]], log_ns: int = 5, **options: Any) -> Path:
    """Topics of sensor_msgs, interleaved by position; log times are log_ns + position."""
    with path.open("wb") as file:
        writer = Ros2Writer(file, **options)
        image = writer.register_msgdef("sensor_msgs/msg/Image", IMAGE)
        jpeg = writer.register_msgdef("sensor_msgs/msg/CompressedImage", COMPRESSED)
        text = writer.register_msgdef("std_msgs/msg/String", "string data")
        for position in range(max(map(len, topics.values()))):
            for topic, messages in topics.items():
                if position < len(messages):
                    message = messages[position]
                    schema = image if "step" in message else jpeg if "format" in message else text
                    writer.write_message(topic, schema, message, log_time=log_ns + position)
        writer.finish()
    return path


def clip(path: Path, **options: Any) -> Path:
    messages = [raw(drawn(number), "bgr8", EPOCH_NS + number * STEP_NS) for number in range(COUNT)]
    return write_ros2(path, {"/camera": messages, "/chatter": [{"data": "hello"}] * 3}, **options)


def write_json(path: Path, schema: str, messages: list[bytes], encoding: str = "json") -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema_id = writer.register_schema(schema, "jsonschema" if encoding == "json" else encoding, b"{}")
        channel = writer.register_channel("/camera", encoding, schema_id)
        for number, data in enumerate(messages):
            writer.add_message(channel, log_time=100 + number, data=data, publish_time=0)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunk_size", [300, 1 << 20])
def test_whole_log(tmp_path: Path, compression: CompressionType, chunk_size: int) -> None:
    source = McapSource(clip(tmp_path / "drive.mcap", compression=compression, chunk_size=chunk_size))
    assert isinstance(source, Source)
    assert (source.name, source.frame_count) == ("drive", COUNT)
    frames = list(source)
    source.close()
    source.close()
    assert [frame.index for frame in frames] == list(range(COUNT))
    assert [frame.stamp_ns for frame in frames] == [EPOCH_NS + number * STEP_NS for number in range(COUNT)]
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, drawn(number))
    assert source.skipped == 0


@pytest.mark.parametrize("options", [{"repeat_channels": False}, {"use_chunking": False}, {"use_statistics": False}])
def test_log_without_index(tmp_path: Path, options: dict[str, bool], caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        schema_id = writer.register_schema("foxglove.CompressedImage", "jsonschema", b"{}")
        channel = writer.register_channel("/camera", "json", schema_id)
        for number in range(4):
            writer.add_message(
                channel, log_time=number, publish_time=0, data=foxglove_compressed(drawn(number), number)
            )
        writer.finish()
    source = McapSource(path)
    assert source.frame_count is None
    assert len(list(source)) == 4
    assert not caplog.records


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "mono16", "16UC1", "rgb8", "bgr8", "8UC3", "rgba8", "bgra8"])
def test_raw_encodings(tmp_path: Path, encoding: str, big_endian: bool, padding: int) -> None:
    deep = "16" in encoding
    channels = {"r": 3, "b": 3, "8UC3": 3}.get(encoding if encoding == "8UC3" else encoding[0], 1) + ("a8" in encoding)
    shape = (5, 7) if channels == 1 else (5, 7, channels)
    image = np.random.default_rng(3).integers(0, 65536 if deep else 256, shape, np.uint16 if deep else np.uint8)
    expected = image if channels == 1 else image[:, :, 2::-1] if encoding[:3] == "rgb" else image[:, :, :3]
    path = write_ros2(tmp_path / "a.mcap", {"/camera": [raw(image, encoding, 1, padding, big_endian)]})
    (frame,) = McapSource(path)
    assert frame.image.dtype == (np.uint16 if deep else np.uint8)
    assert frame.image.dtype.isnative
    assert frame.image.flags.c_contiguous
    assert frame.image.flags.writeable
    np.testing.assert_array_equal(frame.image, expected)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_compressed_images(tmp_path: Path, suffix: str) -> None:
    messages = [compressed(drawn(number), suffix, 10 + number) for number in range(3)]
    frames = list(McapSource(write_ros2(tmp_path / "a.mcap", {"/camera/compressed": messages})))
    assert [frame.stamp_ns for frame in frames] == [10, 11, 12]
    for number, frame in enumerate(frames):
        expected = cv2.imdecode(cv2.imencode(suffix, drawn(number))[1], cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(frame.image, expected)


def test_sixteen_bit_png(tmp_path: Path) -> None:
    depth = np.arange(48, dtype=np.uint16).reshape(6, 8) * 1000
    (frame,) = McapSource(write_ros2(tmp_path / "a.mcap", {"/depth": [compressed(depth, ".png", 1)]}))
    np.testing.assert_array_equal(frame.image, depth)


def foxglove_compressed(image: np.ndarray, stamp_ns: int) -> bytes:
    data = base64.b64encode(cv2.imencode(".png", image)[1]).decode()
    time = {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}
    return json.dumps({"timestamp": time, "frame_id": "camera", "format": "png", "data": data}).encode()


def test_foxglove_json(tmp_path: Path) -> None:
    messages = [foxglove_compressed(drawn(number), EPOCH_NS + number) for number in range(3)]
    frames = list(McapSource(write_json(tmp_path / "a.mcap", "foxglove.CompressedImage", messages)))
    assert [frame.stamp_ns for frame in frames] == [EPOCH_NS, EPOCH_NS + 1, EPOCH_NS + 2]
    np.testing.assert_array_equal(frames[2].image, drawn(2))

    pixels = np.arange(60, dtype=np.uint16).reshape(6, 10) * 1000
    message = {"timestamp": {"sec": 1, "nsec": 5}, "width": 10, "height": 6, "encoding": "mono16", "step": 20}
    message["data"] = base64.b64encode(pixels.tobytes()).decode()
    path = write_json(tmp_path / "b.mcap", "foxglove.RawImage", [json.dumps(message).encode()])
    (frame,) = McapSource(path)
    assert frame.stamp_ns == 1_000_000_005
    np.testing.assert_array_equal(frame.image, pixels)


def test_zero_stamp_falls_back_to_log_time(tmp_path: Path) -> None:
    messages = [raw(drawn(number), "bgr8", 0) for number in range(3)]
    path = write_ros2(tmp_path / "a.mcap", {"/camera": messages}, log_ns=EPOCH_NS)
    assert [frame.stamp_ns for frame in McapSource(path)] == [EPOCH_NS, EPOCH_NS + 1, EPOCH_NS + 2]


def test_choice_of_topic(tmp_path: Path) -> None:
    left = [raw(drawn(0), "bgr8", 1)]
    right = [compressed(drawn(1), ".png", 2)]
    path = write_ros2(tmp_path / "a.mcap", {"/left": left, "/right": right, "/chatter": [{"data": "x"}]})
    with pytest.raises(InputError, match=r"--topic: /left \(sensor_msgs/msg/Image as cdr\), /right"):
        McapSource(path)
    (frame,) = McapSource(path, topic="/right")
    np.testing.assert_array_equal(frame.image, drawn(1))
    with pytest.raises(InputError, match="its image topics are /left"):
        McapSource(path, topic="/middle")
    with pytest.raises(InputError, match=r"/chatter \(std_msgs/msg/String as cdr\) is no image"):
        McapSource(path, topic="/chatter")


def test_no_camera(tmp_path: Path) -> None:
    topics = {f"/topic{number}": [{"data": "x"}] for number in range(8)}
    with pytest.raises(InputError, match=r"no image topic; it holds /topic0 \(std_msgs/msg/String as cdr\).*3 more"):
        McapSource(write_ros2(tmp_path / "a.mcap", topics))
    path = write_json(tmp_path / "b.mcap", "foxglove.CompressedImage", [b"\x0a\x00"], encoding="protobuf")
    with pytest.raises(InputError, match=r"not readable yet: /camera .*protobuf"):
        McapSource(path)
    with pytest.raises(InputError, match="not readable yet"):
        McapSource(path, topic="/camera")
    with pytest.raises(InputError, match="no readable messages"):
        McapSource(write_json(tmp_path / "c.mcap", "foxglove.CompressedImage", []))


@pytest.mark.parametrize("options", [{}, {"chunk_size": 300}, {"compression": CompressionType.NONE, "chunk_size": 300}])
@pytest.mark.parametrize("percent", [*range(0, 100, 10), 99])
def test_cut_log_yields_a_prefix(
    tmp_path: Path, percent: int, options: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    data = clip(tmp_path / "whole.mcap", **options).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * percent // 100])
    try:
        source = McapSource(tmp_path / "cut.mcap")
    except InputError:  # without one whole chunk there is no topic
        assert percent < (100 if not options else 30)
        return
    frames = list(source)
    assert [frame.stamp_ns for frame in frames] == [EPOCH_NS + number * STEP_NS for number in range(len(frames))]
    for number, frame in enumerate(frames):
        assert frame.index == number
        np.testing.assert_array_equal(frame.image, drawn(number))
    if options:
        assert len(frames) >= COUNT * (percent - 30) / 100
    assert sum("cut or damaged" in record.message for record in caplog.records) == 1


def test_a_damaged_chunk_costs_only_itself(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = clip(tmp_path / "a.mcap", chunk_size=300, compression=CompressionType.NONE)
    data = bytearray(path.read_bytes())
    place = data.find(drawn(5).tobytes())
    data[place : place + 20] = bytes(20)
    path.write_bytes(data)
    source = McapSource(path)
    frames = list(source)
    assert source.frame_count == COUNT
    assert len(frames) + source.skipped == COUNT
    assert 1 <= source.skipped <= 3
    assert [record.levelname for record in caplog.records] == ["WARNING", "WARNING"]
    numbers = [(frame.stamp_ns - EPOCH_NS) // STEP_NS for frame in frames]
    assert 5 not in numbers
    assert {0, 1, COUNT - 1} <= set(numbers)


@given(seed=st.integers(0, 2**32 - 1), start=st.floats(0, 1), length=st.integers(1, 400))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@pytest.mark.parametrize("compression", CompressionType)
def test_random_damage(tmp_path: Path, compression: CompressionType, seed: int, start: float, length: int) -> None:
    whole = tmp_path / "whole.mcap"
    if not whole.exists():
        clip(whole, chunk_size=300, compression=compression)
    data = bytearray(whole.read_bytes())
    place = int(start * len(data))
    noise = np.random.default_rng(seed).bytes(length)[: len(data) - place]
    data[place : place + len(noise)] = noise
    (tmp_path / "a.mcap").write_bytes(data)
    try:
        source = McapSource(tmp_path / "a.mcap")
        frames = list(source)
        source.close()
    except InputError:
        return
    assert all(first.stamp_ns < second.stamp_ns for first, second in pairwise(frames))
    assert all(first.index < second.index for first, second in pairwise(frames))


@given(content=st.binary(max_size=300), magic=st.booleans())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_random_bytes_are_an_input_error(tmp_path: Path, content: bytes, magic: bool) -> None:
    (tmp_path / "a.mcap").write_bytes((b"\x89MCAP0\r\n" if magic else b"") + content)
    with pytest.raises(InputError):
        McapSource(tmp_path / "a.mcap")


@given(content=st.binary(max_size=300))
@settings(max_examples=200, deadline=None)
@pytest.mark.parametrize(
    ("schema", "encoding"),
    [
        ("sensor_msgs/msg/Image", "cdr"),
        ("sensor_msgs/msg/CompressedImage", "cdr"),
        ("foxglove.RawImage", "json"),
        ("foxglove.CompressedImage", "json"),
    ],
)
def test_random_messages_are_an_input_error(schema: str, encoding: str, content: bytes) -> None:
    decode = decoder_for(schema, encoding)
    assert decode is not None
    for data in (content, b"\0\1\0\0" + content):
        with pytest.raises(InputError):
            decode(data)


def test_undecodable_messages_keep_their_number(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    good = [raw(drawn(number), "bgr8", 100 + number) for number in range(6)]
    good[1]["encoding"] = "yuv422_yuy2"
    good[2]["width"] = 1 << 30
    good[3]["data"] = good[3]["data"][:-1]
    good[4]["header"] = header(50)
    source = McapSource(write_ros2(tmp_path / "a.mcap", {"/camera": good}))
    assert source.frame_count == 6
    assert [(frame.index, frame.stamp_ns) for frame in source] == [(0, 100), (5, 105)]
    assert source.skipped == 4
    assert len(caplog.records) == 1
    assert "skipped 4 frames" in caplog.text
    assert "message 1 on /camera: image encoding 'yuv422_yuy2'" in caplog.text

    path = write_ros2(tmp_path / "b.mcap", {"/camera": good[1:4]})
    with pytest.raises(InputError, match="not one image"):
        list(McapSource(path))


@pytest.mark.parametrize(
    ("width", "height", "step", "length"),
    [(0, 4, 0, 16), (4, 0, 0, 16), (-4, 4, 0, 16), (4, 4, 3, 16), (4, 4, 0, 15), (4, 4, 5, 18), (2**31, 2**31, 0, 16)],
)
def test_sizes_that_contradict_the_bytes(width: int, height: int, step: int, length: int) -> None:
    with pytest.raises(InputError, match="bytes are no"):
        image_from_pixels(bytes(length), width, height, "mono8", step, False)


def test_last_row_may_lack_its_padding() -> None:
    image = image_from_pixels(bytes(range(19)), 4, 4, "mono8", 5, False)
    np.testing.assert_array_equal(image[3], [15, 16, 17, 18])


def test_missing_file_and_folder(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "missing.mcap", "nul\0.mcap", "x" * 5000):
        with pytest.raises(InputError, match="cannot open the log"):
            McapSource(path)


@pytest.mark.parametrize("name", ["chatter_my_bag_0.mcap", "nav2_turtlebot.mcap"])
def test_real_logs_without_camera(name: str) -> None:
    path = DATA / "mcap_without_camera" / name
    if not path.exists():
        pytest.skip("the log is not on this machine")
    with pytest.raises(InputError, match="no image topic; it holds "):
        McapSource(path)

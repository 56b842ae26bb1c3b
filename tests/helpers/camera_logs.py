"""Logs with cameras, written by the standard MCAP writer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from mcap.writer import Writer

from tests.helpers.camera_messages import cdr, image_fields

STEP_NS = 100_000_000
EPOCH_NS = 1_700_000_000_000_000_000


class Logged(NamedTuple):
    """A message with its time in the log."""

    log_ns: int
    data: bytes
    publish_ns: int = 0


class Channel(NamedTuple):
    """Messages of one topic and type."""

    schema: str
    encoding: str
    messages: Sequence[Logged]


def drawn(number: int) -> np.ndarray:
    """A small noisy BGR picture that tells its number."""
    image = np.random.default_rng(number).integers(0, 256, (6, 8, 3), np.uint8)
    image[0, 0] = number
    return image


def raw(number: int, stamp_ns: int, encoding: str = "bgr8") -> bytes:
    """A ROS 2 Image that holds `drawn(number)`."""
    image = drawn(number)
    height, width = image.shape[:2]
    return cdr("Image", stamp_ns=stamp_ns, **image_fields(image.tobytes(), width, height, encoding, 3 * width))


def encoded(number: int, stamp_ns: int) -> bytes:
    """A ROS 2 CompressedImage that holds `drawn(number)`."""
    data = cv2.imencode(".png", drawn(number))[1]
    return cdr("CompressedImage", stamp_ns=stamp_ns, format="free text", data=data)


def images(count: int, late_ns: int = 0, kind: str = "Image") -> Channel:
    """A steady camera at 10 Hz whose messages are logged `late_ns` after their stamps."""
    times = [EPOCH_NS + number * STEP_NS for number in range(count)]
    make = raw if kind == "Image" else encoded
    messages = [Logged(time + late_ns, make(number, time)) for number, time in enumerate(times)]
    return Channel(f"sensor_msgs/msg/{kind}", "cdr", messages)


def text(count: int = 3) -> Channel:
    """A topic that is no camera."""
    messages = [Logged(EPOCH_NS + number, b"\0\1\0\0hello") for number in range(count)]
    return Channel("std_msgs/msg/String", "cdr", messages)


def write_log(
    path: Path, topics: Mapping[str, Channel], chunk_size: int = 1000, definition: bytes = b"not looked at"
) -> Path:
    """Write the topics' messages in order of their log times."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size)
        writer.start()
        rows = []
        for topic, channel in topics.items():
            schema = writer.register_schema(channel.schema, "ros2msg", definition)
            number = writer.register_channel(topic, channel.encoding, schema)
            rows += [(message, number) for message in channel.messages]
        for message, number in sorted(rows, key=lambda row: row[0].log_ns):
            writer.add_message(number, message.log_ns, message.data, message.publish_ns)
        writer.finish()
    return path

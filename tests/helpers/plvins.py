"""PL-VINS in miniature: what its trackers publish, how its estimator takes messages, and readers of its messages.

After what cnqiangfu/PL-VINS does (commit da47af3, its feature_tracker and vins_estimator).
"""

from __future__ import annotations

import json
import math
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

from logs.sinks.plvins import TOPIC

Lines = dict[int, tuple[float, float, float, float]]
Clouds = list[tuple[int, Lines]]

ROS1 = ["/usr/bin/python3", "-I"]  # where Debian's python3-rosbag is
has_rosbag = pytest.mark.skipif(
    not Path(ROS1[0]).exists() or subprocess.run([*ROS1, "-c", "import rosbag"], capture_output=True).returncode != 0,
    reason="Debian's python3-rosbag is not installed",
)
READ = """
import json, sys, rosbag
for topic, cloud, time in rosbag.Bag(sys.argv[1]).read_messages():
    ends = [(channel.name, list(channel.values)) for channel in cloud.channels]
    starts = [(point.x, point.y, point.z) for point in cloud.points]
    print(json.dumps([topic, cloud._type, time.to_nsec(), cloud.header.stamp.to_nsec(), starts, ends]))
"""


def lines_of(starts: Iterable[tuple[float, float, float]], channels: list[Any]) -> Lines:
    """What the estimator makes of a message: start and end by number."""
    lines: Lines = {}
    for k, (x, y, z) in enumerate(starts):
        number = int(channels[0][k] + 0.5)
        assert number not in lines
        assert z == 1
        lines[number] = (x, y, channels[1][k], channels[2][k])
    return lines


def clouds_of(messages: Iterable[Any]) -> Clouds:
    """Stamps and lines of messages of ROS 1, rosbags or ROS 2."""
    clouds = []
    for cloud in messages:
        stamp = cloud.header.stamp
        seconds, rest = (stamp.secs, stamp.nsecs) if hasattr(stamp, "secs") else (stamp.sec, stamp.nanosec)
        starts = [(point.x, point.y, point.z) for point in cloud.points]
        assert [channel.name for channel in cloud.channels] == ["id_of_line", "u_of_endpoint", "v_of_endpoint"]
        assert cloud.header.frame_id == "world"
        lines = lines_of(starts, [list(map(float, channel.values)) for channel in cloud.channels])
        clouds.append((seconds * 10**9 + rest, lines))
    return clouds


def read_mcap(path: Path) -> Clouds:
    """With MCAP's reader and decoder of ROS 1."""
    messages = []
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, cloud in reader.iter_decoded_messages():
            assert schema is not None
            assert (channel.topic, channel.message_encoding) == (TOPIC, "ros1")
            assert (schema.name, schema.encoding) == ("sensor_msgs/PointCloud", "ros1msg")
            stamp = cloud.header.stamp
            assert message.log_time == message.publish_time == stamp.secs * 10**9 + stamp.nsecs
            messages.append(cloud)
    return clouds_of(messages)


def read_bag(path: Path) -> Clouds:
    """With rosbags."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(path) as reader:
        return clouds_of(store.deserialize_ros1(data, one.msgtype) for one, _, data in reader.messages())


def read_rosbag(path: Path) -> Clouds:
    """With ROS 1's own rosbag."""
    done = subprocess.run([*ROS1, "-c", READ, path], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    clouds = []
    for line in done.stdout.splitlines():
        topic, kind, time_ns, stamp_ns, starts, channels = json.loads(line)
        assert (topic, kind, time_ns) == (TOPIC, "sensor_msgs/PointCloud", stamp_ns)
        clouds.append((stamp_ns, lines_of(starts, [values for _, values in channels])))
    return clouds


def published(stamps_ns: list[int], freq: int) -> list[int]:
    """Which of a camera's images the trackers publish.

    An image passes while the messages so far, beginning with one, are at most `freq` per second of the time since the
    first image, to the nearest whole number; and time and count start again whenever the rate is met to within 1 %.
    """
    freq = freq or 100
    start_s, count, passed = stamps_ns[0] / 1e9, 1, []
    for k, stamp_ns in enumerate(stamps_ns):
        elapsed_s = stamp_ns / 1e9 - start_s
        rate = count / elapsed_s if elapsed_s else math.inf
        if rate >= freq + 0.5:
            continue
        if abs(rate - freq) < 0.01 * freq:
            start_s, count = stamp_ns / 1e9, 0
        count += 1
        passed.append(k)
    return passed


def landmarks(clouds: Iterable[Lines]) -> list[tuple[int, list[tuple[float, float, float, float]]]]:
    """The estimator's landmarks: the pair that began each, and its observations, one for each pair from there on."""
    found: dict[int, tuple[int, list[tuple[float, float, float, float]]]] = {}
    for position, lines in enumerate(clouds):
        for number, line in lines.items():
            found.setdefault(number, (position, []))[1].append(line)
    return list(found.values())

"""PL-VINS and its kin in miniature: what its trackers publish, how the estimators take messages, and readers of these.

After what cnqiangfu/PL-VINS (commit da47af3), LeiXu1999/EPLF-VINS (ac78538) and url-kaist/UV-SLAM (303ab90) do in their
feature_tracker and vins_estimator.
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

TOPIC, POINTS_TOPIC = "/linefeature_tracker/linefeature", "/feature_tracker/feature"
Lines = dict[int, tuple[float, ...]]
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
        starts = [(point.x, point.y, point.z) for point in cloud.points]
        names = [channel.name for channel in cloud.channels]
        assert names[:3] == ["id_of_line", "u_of_endpoint", "v_of_endpoint"]
        assert names[3:] == ["start_u_of_line", "start_v_of_line", "end_u_of_line", "end_v_of_line"]
        assert cloud.header.frame_id == "world"
        lines = lines_of(starts, [list(map(float, channel.values)) for channel in cloud.channels])
        clouds.append((stamp_of(cloud), lines))
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
    return clouds_of(message for topic, message in read_messages(path) if topic == TOPIC)


def read_messages(path: Path) -> list[tuple[str, Any]]:
    """Topic and message of everything in a bag or an MCAP file, in its order."""
    if path.suffix == ".mcap":
        with path.open("rb") as file:
            found = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
            return [(channel.topic, message) for _, channel, _, message in found]
    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(path) as reader:
        return [(one.topic, store.deserialize_ros1(data, one.msgtype)) for one, _, data in reader.messages()]


def stamp_of(message: Any) -> int:
    """Nanoseconds, of ROS 1, rosbags or ROS 2."""
    stamp = message.header.stamp
    seconds, rest = (stamp.secs, stamp.nsecs) if hasattr(stamp, "secs") else (stamp.sec, stamp.nanosec)
    return int(seconds) * 10**9 + int(rest)


def points_of(cloud: Any, channels: int = 5) -> Lines:
    """What VINS-Mono's estimator makes of a message, and those of PL-VINS and EPLF-VINS with three channels.

    Returns:
        x, y, u, v and velocities by number.
    """
    found: Lines = {}
    values = [list(map(float, channel.values)) for channel in cloud.channels[:channels]]
    for k, point in enumerate(cloud.points):
        number = int(values[0][k] + 0.5)
        assert point.z == 1
        assert number not in found
        found[number] = (point.x, point.y, *(channel[k] for channel in values[1:]))
    return found


def uv_lines_of(cloud: Any) -> Lines:
    """What UV-SLAM's estimator makes of a message: ends, their pixels and velocities, and the vanishing point."""
    values = [list(map(float, channel.values)) for channel in cloud.channels[5:21]]
    found = {int(number + 0.5): tuple(channel[k] for channel in values[1:]) for k, number in enumerate(values[0])}
    assert len(found) == len(values[0])
    return found


def plvins_pairs(messages: list[tuple[str, Any]]) -> list[tuple[Any, Any]]:
    """The points and lines that PL-VINS takes for those of one time: the k-th message of each topic."""
    sent = [[message for topic, message in messages if topic == one] for one in (POINTS_TOPIC, TOPIC)]
    return list(zip(*sent, strict=False))


def eplf_pairs(messages: list[tuple[str, Any]]) -> list[tuple[Any, Any]]:
    """Those of EPLF-VINS: equal stamps, and what has no partner is thrown away."""
    topics = "/lf_feature_tracker/feature", "/lf_linefeature_tracker/linefeature"
    points, lines = ([message for topic, message in messages if topic == one] for one in topics)
    pairs = []
    while points and lines:
        if stamp_of(points[0]) > stamp_of(lines[0]):
            lines.pop(0)
        elif stamp_of(points[0]) < stamp_of(lines[0]):
            points.pop(0)
        else:
            pairs.append((points.pop(0), lines.pop(0)))
    return pairs


def uvslam_runs(messages: list[tuple[str, Any]]) -> list[list[Any]]:
    """What UV-SLAM's estimator works on, anew after each restart; it throws the first message of all away."""
    runs: list[list[Any]] = [[]]
    first = True
    for topic, message in messages:
        if topic == "/feature_tracker/restart" and message.data:
            runs.append([])
        elif topic == POINTS_TOPIC:
            runs[-1] += [] if first else [message]
            first = False
    return runs


def read_rosbag(path: Path) -> Clouds:
    """Those of lines, with ROS 1's own rosbag."""
    done = subprocess.run([*ROS1, "-c", READ, path], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    clouds = []
    for line in done.stdout.splitlines():
        topic, kind, time_ns, stamp_ns, starts, channels = json.loads(line)
        assert (kind, time_ns) == ("sensor_msgs/PointCloud", stamp_ns)
        if topic == TOPIC:
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


def landmarks(clouds: Iterable[Lines]) -> list[tuple[int, list[tuple[float, ...]]]]:
    """The estimator's landmarks: the pair that began each, and its observations, one for each pair from there on."""
    found: dict[int, tuple[int, list[tuple[float, ...]]]] = {}
    for position, lines in enumerate(clouds):
        for number, line in lines.items():
            found.setdefault(number, (position, []))[1].append(line)
    return list(found.values())

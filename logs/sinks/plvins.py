"""Tracked lines as PL-VINS takes them from its own line tracker, in a ROS 1 bag or an MCAP file.

PL-VINS (Fu et al., "PL-VINS: Real-Time Monocular Visual-Inertial SLAM with Point and Line Features", 2020;
github.com/cnqiangfu/PL-VINS) is a ROS 1 system. Its estimator subscribes to `/linefeature_tracker/linefeature`, so play
this file instead of running its node `linefeature_tracker`.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from airline.errors import ConfigError, InputError
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from logs.sinks.bag import BagOutput
from logs.sinks.output import McapOutput
from logs.tracks.json import SECOND_NS

TOPIC = "/linefeature_tracker/linefeature"
MOST_MISSING = 100_000  # images, about an hour of a camera

_TYPE = "sensor_msgs/msg/PointCloud"
_FRAME_ID = "world"
_NUMBERS = 2**24  # float32 has every whole number below

Cloud = tuple[int, NDArray[np.float32], NDArray[np.float32]]


class PlVinsLines:
    """What PL-VINS gets of each frame: how many messages, with which lines, under which numbers.

    PL-VINS's estimator pairs the messages of lines with those of its point tracker by their order, not their stamps.

    - So image 0 of the recording has no message. The tracker limits its rate to what it has published so far, divided
      by the time since its first image; with the first image itself that is one by zero, and nothing is published.
      (That of EPLF-VINS does the same, and pairs by stamp: nothing is lost.)
    - From there on it publishes every stride-th image, and each of them has a message, by `frame_index`: an empty one
      before the next frame's, if it could not be read, or was dropped or left out before the first frame. Stamps of
      empty ones lie between their neighbours', or 1 ns apart before the first frame's, but not before 1970.
    - Only confirmed tracks: PL-VINS makes a landmark of every number, and has no way to take back one that was noise.
    - Numbers are not track ids. PL-VINS takes the observations of a number for those of consecutive messages: a track
      that was lost for a while goes on under a new one. And it sends numbers as float32, so they are counted from 0
      and begin again at 2^24. By then their first holders are long gone from its window of ten frames.
    - Lines as observed: the estimator takes the errors of different frames for independent, which fused lines' are not.
    - Lines with an end that no undistortion reaches are left out.
    """

    def __init__(self, stride: int = 1) -> None:
        """Lines of every stride-th image of a recording."""
        self._stride = stride
        self._numbers: dict[int, int] = {}  # of the tracks in the message before
        self._next = 0
        self._before: tuple[int, int] | None = None  # index and stamp of the frame before
        self._written = 0  # image of the message before

    def of_frame(self, tracks: LineTracks) -> list[Cloud]:
        """The messages of the images since the frame before, the last of them the next frame's own.

        Returns:
            For each message its stamp (ns), (K,) float32 numbers, and (K, 2, 2) float32 end points, undistorted, on the
            plane z = 1.

        Raises:
            ConfigError: a frame without a camera, or between two strides.
            InputError: more than `MOST_MISSING` images are missing.
        """
        segments = tracks.observed_normalized
        if segments is None:
            raise ConfigError("PL-VINS needs normalized coordinates: give the camera's calibration with --calib FILE")
        index, stamp_ns = tracks.frame_index, tracks.stamp_ns
        if index % self._stride:  # behind --start
            raise ConfigError(
                f"frame {index} is none that PL-VINS publishes, which are those whose number {self._stride} divides: "
                "use another --start"
            )
        due = range(self._written + self._stride, index + 1, self._stride)
        before, before_ns = self._before or (0, max(0, stamp_ns - index))
        self._before = index, stamp_ns
        if not due:
            return []
        missing = len(due) - 1
        if missing > MOST_MISSING:
            raise InputError(
                f"{missing} images are missing before frame {index}, and PL-VINS needs an empty message for each: no "
                f"more than {MOST_MISSING} are written"
            )
        if missing:
            self._numbers = {}
        self._written = index
        usable = tracks.confirmed & np.isfinite(segments).all((1, 2))
        numbers = {}
        for track in tracks.ids[usable].tolist():
            number = self._numbers.get(track)
            if number is None:
                number, self._next = self._next, (self._next + 1) % _NUMBERS
            numbers[track] = number
        self._numbers = numbers
        nothing = np.zeros(0, np.float32), np.zeros((0, 2, 2), np.float32)
        empty: list[Cloud] = [
            (before_ns + (stamp_ns - before_ns) * (image - before) // (index - before), *nothing) for image in due[:-1]
        ]
        return [*empty, (stamp_ns, np.array(list(numbers.values()), np.float32), segments[usable])]


class PlVinsBagSink:
    """Writes a `sensor_msgs/PointCloud` for each image but the first into a ROS 1 bag, for `rosbag play`; a `Sink`.

    A message has the frame's stamp and, for each of the `PlVinsLines`, the start in `points` and in `channels` the
    number, and u and v of the end. PL-VINS's point tracker has to publish the same images, or lines meet the points of
    other ones: `freq: 0` in PL-VINS's configuration.

    Args:
        path, overwrite: see `OutputFile`, also for errors; those of `PlVinsLines.of_frame` come while writing.
        stride: the frames are every stride-th image of the recording.
    """

    _output: BagOutput | McapOutput

    def __init__(self, path: str | os.PathLike[str], *, overwrite: bool = False, stride: int = 1) -> None:
        self._store = get_typestore(Stores.ROS1_NOETIC)
        self._lines = PlVinsLines(stride)
        self._count = 0
        self._open(Path(path), overwrite, *self._store.generate_msgdef(_TYPE, ros_version=1))

    def _open(self, path: Path, overwrite: bool, definition: str, digest: str) -> None:
        self._output = output = BagOutput(path, overwrite)
        self._add = partial(output.write, output.connection(TOPIC, _TYPE, definition, digest))

    def write(self, result: FrameResult) -> None:
        """Add one frame's tracks."""
        stamp_ns = result.tracks.stamp_ns
        if not 0 <= stamp_ns < 2**32 * SECOND_NS:
            raise InputError(f"ROS 1 has no time {stamp_ns} ns: it counts from 1970 to 2106")
        for cloud in self._lines.of_frame(result.tracks):
            self._add(cloud[0], self._message(*cloud))
        self._output.flush_when_due()

    def close(self) -> None:
        """Write the file's index; safe to call twice."""
        self._output.close()

    def _message(self, stamp_ns: int, numbers: NDArray[np.float32], segments: NDArray[np.float32]) -> bytes:
        types = self._store.types
        seconds, nanoseconds = divmod(stamp_ns, SECOND_NS)
        stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        point, channel = types["geometry_msgs/msg/Point32"], types["sensor_msgs/msg/ChannelFloat32"]
        u, v = np.ascontiguousarray(segments[:, 1].T)
        named = {"id_of_line": numbers, "u_of_endpoint": u, "v_of_endpoint": v}
        message = types[_TYPE](
            header=types["std_msgs/msg/Header"](seq=self._count % 2**32, stamp=stamp, frame_id=_FRAME_ID),
            points=[point(x=x, y=y, z=1.0) for x, y in segments[:, 0].tolist()],
            channels=[channel(name=name, values=values) for name, values in named.items()],
        )
        self._count += 1
        return bytes(self._store.serialize_ros1(message, _TYPE))


class PlVinsTrackSink(PlVinsBagSink):
    """The same messages in an MCAP file, for players of that format: ROS 1 itself has none."""

    def _open(self, path: Path, overwrite: bool, definition: str, digest: str) -> None:
        metadata = {"lines": "normalized coordinates on the plane z = 1: start in points, number and end in channels"}
        self._output = output = McapOutput(path, overwrite, metadata, profile="ros1")
        channel = output.channel(TOPIC, "ros1", "sensor_msgs/PointCloud", "ros1msg", definition.encode())
        self._add = partial(output.write, channel)

"""Tracked lines as PL-VINS takes them from its own line tracker, in an MCAP file.

PL-VINS (Fu et al., "PL-VINS: Real-Time Monocular Visual-Inertial SLAM with Point and Line Features", 2020;
github.com/cnqiangfu/PL-VINS) is a ROS 1 system. Its estimator subscribes to `/linefeature_tracker/linefeature`, so play
this file instead of running its node `linefeature_tracker`.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from airline.errors import ConfigError, InputError
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from logs.sinks.output import McapOutput
from logs.tracks.json import SECOND_NS

TOPIC = "/linefeature_tracker/linefeature"

_TYPE = "sensor_msgs/msg/PointCloud"
_FRAME_ID = "world"
_NUMBERS = 2**24  # float32 has every whole number below


class PlVinsLines:
    """Which lines of a frame PL-VINS gets, and under which numbers.

    - Only confirmed tracks: PL-VINS makes a landmark of every number, and has no way to take back one that was noise.
    - Numbers are not track ids. PL-VINS takes the observations of a number for those of consecutive frames, so a track
      that was lost for a while goes on under a new one; and it sends numbers as float32, so they are counted from 0
      and begin again at 2^24. By then their first holders are long gone from its window of ten frames.
    - Lines as observed: the estimator takes the errors of different frames for independent, which fused lines' are not.
    - Lines with an end that no undistortion reaches are left out.
    """

    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}  # of the tracks in the frame before
        self._next = 0

    def of_frame(self, tracks: LineTracks) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The lines of the next frame.

        Returns:
            (K,) float32 numbers, and (K, 2, 2) float32 end points, undistorted, on the plane z = 1.

        Raises:
            ConfigError: a frame without a camera.
        """
        segments = tracks.observed_normalized
        if segments is None:
            raise ConfigError("PL-VINS needs normalized coordinates: give the camera's calibration with --calib FILE")
        usable = tracks.confirmed & np.isfinite(segments).all((1, 2))
        numbers = {}
        for track in tracks.ids[usable].tolist():
            number = self._numbers.get(track)
            if number is None:
                number, self._next = self._next, (self._next + 1) % _NUMBERS
            numbers[track] = number
        self._numbers = numbers
        return np.array(list(numbers.values()), np.float32), segments[usable]


class PlVinsTrackSink:
    """Writes each frame's lines as a `sensor_msgs/PointCloud` of ROS 1; a `Sink`.

    A message has the frame's stamp and, for each of the `PlVinsLines`, the start in `points` and in `channels` the
    number, and u and v of the end. Every frame has a message, even if it is empty: PL-VINS pairs them with those of its
    point tracker by their order. So that tracker has to use every frame too: set `freq` in PL-VINS's configuration
    above the rate of the frames.

    Arguments and errors are those of `OutputFile`; a frame without a camera is a ConfigError.
    """

    def __init__(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        self._store = get_typestore(Stores.ROS1_NOETIC)
        definition, _ = self._store.generate_msgdef(_TYPE, ros_version=1)
        metadata = {"lines": "normalized coordinates on the plane z = 1: start in points, number and end in channels"}
        self._output = McapOutput(Path(path), overwrite, metadata, profile="ros1")
        self._channel = self._output.channel(TOPIC, "ros1", "sensor_msgs/PointCloud", "ros1msg", definition.encode())
        self._lines = PlVinsLines()
        self._frames = 0

    def write(self, result: FrameResult) -> None:
        """Add one frame's tracks."""
        tracks = result.tracks
        numbers, segments = self._lines.of_frame(tracks)
        if not 0 <= tracks.stamp_ns < 2**32 * SECOND_NS:
            raise InputError(f"ROS 1 has no time {tracks.stamp_ns} ns: it counts from 1970 to 2106")
        types = self._store.types
        seconds, nanoseconds = divmod(tracks.stamp_ns, SECOND_NS)
        stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        point, channel = types["geometry_msgs/msg/Point32"], types["sensor_msgs/msg/ChannelFloat32"]
        u, v = np.ascontiguousarray(segments[:, 1].T)
        named = {"id_of_line": numbers, "u_of_endpoint": u, "v_of_endpoint": v}
        message = types[_TYPE](
            header=types["std_msgs/msg/Header"](seq=self._frames % 2**32, stamp=stamp, frame_id=_FRAME_ID),
            points=[point(x=x, y=y, z=1.0) for x, y in segments[:, 0].tolist()],
            channels=[channel(name=name, values=values) for name, values in named.items()],
        )
        self._output.write(self._channel, tracks.stamp_ns, bytes(self._store.serialize_ros1(message, _TYPE)))
        self._output.flush_when_due()
        self._frames += 1

    def close(self) -> None:
        """Write the file's index; safe to call twice."""
        self._output.close()

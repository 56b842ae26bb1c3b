"""Tracked lines and points as PL-VINS and its kin take them from their own trackers, in a ROS 1 bag or an MCAP file.

PL-VINS (Fu et al., "PL-VINS: Real-Time Monocular Visual-Inertial SLAM with Point and Line Features", 2020), EPLF-VINS
(Xu et al., "EPLF-VINS: Real-Time Monocular Visual-Inertial SLAM With Efficient Point-Line Flow Features", 2023) and
UV-SLAM (Lim et al., "UV-SLAM: Unconstrained Line-based SLAM Using Vanishing Points for Structural Mapping", 2022) are
ROS 1 systems, and monocular: of a pair of cameras they get the left one's lines. Play this file instead of running
their trackers; `logs.sinks.clouds` has topics and channels.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from airline.errors import ConfigError, InputError
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from logs.sinks.bag import BagOutput
from logs.sinks.clouds import SYSTEMS, Cloud, Float32, Observed, check_points
from logs.sinks.output import McapOutput
from logs.tracks.json import SECOND_NS

MOST_MISSING = 100_000  # images, about an hour of a camera

_CLOUD, _BOOL = "sensor_msgs/msg/PointCloud", "std_msgs/msg/Bool"
_FRAME_ID = "world"
_NUMBERS = 2**24  # float32 has every whole number below

log = logging.getLogger(__name__)


class _Numbers:
    """Numbers for the ids of consecutive messages.

    The estimators take the k-th observation of a number for that in the k-th message from its first: an id that was
    away for a while goes on under a new number. And they get numbers as float32, so these are counted from 0 and begin
    again at 2^24. By then their first holders are long gone from a window of ten frames.
    """

    def __init__(self) -> None:
        self._given: dict[int, int] = {}
        self._next = 0

    def of(self, ids: NDArray[np.int64]) -> Float32:
        given = {}
        for one in ids.tolist():
            if one in self._given:
                given[one] = self._given[one]
            else:
                given[one], self._next = self._next, (self._next + 1) % _NUMBERS
        self._given = given
        return np.array(list(given.values()), np.float32)


class Messages:
    """What a system gets of each frame.

    - Only confirmed tracks: a landmark is made of every number, and one that was noise cannot be taken back.
    - Lines as observed: the estimators take the errors of different frames for independent, which fused lines' are not.
    - Lines with an end that no undistortion reaches, and such points, are left out.

    With points, both come from here:

    - A point is sent from its second frame on, with its velocity since the frame before, as UV-SLAM's tracker does.
    - A frame without such a point has no message, so the first has none, nor has one behind a reset: the estimators
      cannot place a frame by lines alone, and one without points breaks all tracks. Nor has a frame that was not read.
    - VINS-Mono and UV-SLAM throw away the first message that they get.

    Without points, PL-VINS's own tracker makes them, and pairs of messages are told by their order, not their stamps:

    - So image 0 of the recording has no message. The tracker limits its rate to what it has published so far, divided
      by the time since its first image; with the first image itself that is one by zero, and nothing is published.
      (That of EPLF-VINS does the same, and pairs by stamp: nothing is lost.)
    - From there on it publishes every stride-th image, and each of them has a message, by `frame_index`: an empty one
      before the next frame's, if it could not be read, or was dropped or left out before the first frame. Stamps of
      empty ones lie between their neighbours', or 1 ns apart before the first frame's, but not before 1970.

    Attributes:
        jumped: the clock went back before this frame, or on by more than a second: UV-SLAM's tracker would say
            "restart".
        silent: frames so far, but for the first, that have no message for want of points.
    """

    def __init__(self, system: str = "plvins", stride: int = 1, points: bool = False) -> None:
        """Lines, and points too, of every stride-th image of a recording; raises ConfigError for lines without them."""
        check_points(system, points)
        self._name, self._points, self._stride = SYSTEMS[system].name, points, stride
        self._fills = SYSTEMS[system].by_order and not points
        self._line_numbers, self._point_numbers = _Numbers(), _Numbers()
        self._before: LineTracks | None = None
        self._written = 0 if self._fills else -1  # image of the message before
        self.jumped, self.silent = False, 0

    def of_frame(self, tracks: LineTracks) -> list[Observed]:
        """The messages of the images since the frame before, the last of them the next frame's own.

        Raises:
            ConfigError: a frame without a camera, or between two strides.
            InputError: more than `MOST_MISSING` images are missing.
        """
        lines = tracks.observed_normalized
        if lines is None:
            raise ConfigError(
                f"{self._name} needs normalized coordinates: give the camera's calibration with --calib FILE"
            )
        empty = self._missing(tracks) if self._fills else []
        before, self._before = self._before, tracks
        self.jumped = before is not None and not 0 <= tracks.stamp_ns - before.stamp_ns <= SECOND_NS
        if tracks.frame_index <= self._written:
            return []
        seen: dict[str, Any] = {}
        if self._points:
            seen = self._moved(before, tracks)
            if not seen:
                self.silent += before is not None
                return []
        self._written = tracks.frame_index
        usable = tracks.confirmed & np.isfinite(lines).all((1, 2))
        numbers = self._line_numbers.of(tracks.ids[usable])
        return [*empty, Observed(tracks.stamp_ns, tracks.camera, numbers, lines[usable], **seen)]

    def _moved(self, before: LineTracks | None, tracks: LineTracks) -> dict[str, Float32]:
        """The points that the frame before had, too; empty if there is none."""
        now = tracks.points_normalized
        if before is None or before.points_normalized is None or now is None or before.stamp_ns >= tracks.stamp_ns:
            return {}
        ids, rows, earlier = np.intersect1d(tracks.point_ids, before.point_ids, True, return_indices=True)
        velocities = (now[rows] - before.points_normalized[earlier]) / ((tracks.stamp_ns - before.stamp_ns) / SECOND_NS)
        known = np.isfinite(velocities).all(1)
        if not known.any():
            return {}
        rows = rows[known]
        return {
            "point_numbers": self._point_numbers.of(ids[known]),
            "points": now[rows],
            "points_px": tracks.points_px[rows],
            "velocities": velocities[known].astype(np.float32),
        }

    def _missing(self, tracks: LineTracks) -> list[Observed]:
        """Empty messages of the images between."""
        index, stamp_ns = tracks.frame_index, tracks.stamp_ns
        if index % self._stride:  # behind --start
            raise ConfigError(
                f"frame {index} is none that {self._name} publishes, which are those whose number {self._stride} "
                "divides: use another --start"
            )
        due = range(self._written + self._stride, index, self._stride)
        if len(due) > MOST_MISSING:
            raise InputError(
                f"{len(due)} images are missing before frame {index}, and {self._name} needs an empty message for "
                f"each: no more than {MOST_MISSING} are written"
            )
        if due:
            self._line_numbers.of(tracks.ids[:0])
        first, first_ns = (
            (0, max(0, stamp_ns - index)) if self._before is None else (self._before.frame_index, self._before.stamp_ns)
        )
        return [Observed(first_ns + (stamp_ns - first_ns) * (image - first) // (index - first)) for image in due]


class VinsSink:
    """Writes the clouds of PL-VINS, EPLF-VINS or UV-SLAM into a ROS 1 bag, for `rosbag play`, or MCAP; a `Sink`.

    Without points PL-VINS's point tracker has to publish the same images, or lines meet the points of other ones:
    `freq: 0` in PL-VINS's configuration.

    Args:
        path, overwrite: see `OutputFile`, also for errors; those of `Messages.of_frame` come while writing.
        system: a key of `SYSTEMS`.
        bag: a ROS 1 bag rather than MCAP, for players of that format: ROS 1 itself has none.
        stride: the frames are every stride-th image of the recording.
        points: write the points, too; the tracks have them.

    Raises:
        ConfigError: no points for a system that takes them with the lines.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        system: str = "plvins",
        *,
        bag: bool = True,
        overwrite: bool = False,
        stride: int = 1,
        points: bool = False,
    ) -> None:
        self._messages, kind = Messages(system, stride, points), SYSTEMS[system]
        self._store = get_typestore(Stores.ROS1_NOETIC)
        self._count = self._partners = 0
        self._name = kind.name
        self._output = (
            BagOutput(Path(path), overwrite) if bag else McapOutput(Path(path), overwrite, {}, profile="ros1")
        )
        clouds = [*filter(None, [kind.lines]), *([kind.points] if points else [])]
        self._clouds = [(cloud, self._topic(cloud.topic, _CLOUD)) for cloud in clouds]
        self._restart = self._topic(kind.restart, _BOOL) if kind.restart else None

    def write(self, result: FrameResult) -> None:
        """Add one frame's tracks."""
        stamp_ns = result.tracks.stamp_ns
        if not 0 <= stamp_ns < 2**32 * SECOND_NS:
            raise InputError(f"ROS 1 has no time {stamp_ns} ns: it counts from 1970 to 2106")
        found = self._messages.of_frame(result.tracks)
        self._partners += int(np.count_nonzero(result.tracks.right_hits))
        if self._restart is not None and self._messages.jumped:
            self._restart(stamp_ns, self._bytes(self._store.types[_BOOL](data=True)))
        for observed in found:
            for cloud, add in self._clouds:
                add(observed.stamp_ns, self._bytes(self._message(cloud, observed)))
            self._count += 1
        self._output.flush_when_due()

    def close(self) -> None:
        """Write the file's index; safe to call twice."""
        if self._output.is_open and self._messages.silent:
            log.warning("%s: %d frames have no message, for want of points", self._output.path, self._messages.silent)
        if self._output.is_open and self._partners:
            said = "%s: %s takes the left lines, %d partners are left out"
            log.warning(said, self._output.path, self._name, self._partners)
        self._output.close()

    def _topic(self, topic: str, kind: str) -> Callable[[int, bytes], None]:
        """Announce a topic; returns what adds a message at a stamp."""
        definition, digest = self._store.generate_msgdef(kind, ros_version=1)
        if isinstance(self._output, BagOutput):
            return partial(self._output.write, self._output.connection(topic, kind, definition, digest))
        schema = kind.replace("/msg/", "/"), "ros1msg", definition.encode()
        return partial(self._output.write, self._output.channel(topic, "ros1", *schema))

    def _message(self, cloud: Cloud, observed: Observed) -> Any:
        types = self._store.types
        seconds, nanoseconds = divmod(observed.stamp_ns, SECOND_NS)
        stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        point, channel = types["geometry_msgs/msg/Point32"], types["sensor_msgs/msg/ChannelFloat32"]
        return types[_CLOUD](
            header=types["std_msgs/msg/Header"](seq=self._count % 2**32, stamp=stamp, frame_id=_FRAME_ID),
            points=[point(x=x, y=y, z=1.0) for x, y in cloud.points(observed).tolist()],
            channels=[channel(name=name, values=values) for name, values in cloud.columns(observed).items()],
        )

    def _bytes(self, message: Any) -> bytes:
        return bytes(self._store.serialize_ros1(message, message.__msgtype__))

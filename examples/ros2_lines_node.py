"""A ROS 2 node with lines for PL-VINS and RViz: `python3 ros2_lines_node.py tcp://127.0.0.1:5555 [--points]`.

It publishes what `python -m frontend.run ... --publish tcp://127.0.0.1:5555 [--points]` sends. It is one file that
imports nothing of that package, so Humble's Python 3.10 runs it, too: `apt install python3-zmq python3-msgpack
python3-numpy`. With points it stands for PL-VINS's point tracker, too. Both are monocular: of a pair of cameras this
takes the left one's lines.
"""

import sys

import msgpack
import numpy as np
import rclpy
import zmq
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Point32, Vector3
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import ChannelFloat32, PointCloud
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

MOST_MISSING = 1000  # images; as many clouds wait for a slow subscriber
ARRAYS = {"ids": ("<i8",), "states": ("|u1",), "stable": ("|b1",), "observed_normalized": ("<f4", 2, 2)}
POINTS = {"point_ids": ("<i8",), "points_px": ("<f4", 2), "points_normalized": ("<f4", 2)}


def frames_from(address):
    """The frames of a stream, to its end."""
    stream = None
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.subscribe(b"")
        socket.connect(address)
        while (frame := frame_of(socket.recv()))["type"] != "end":
            if stream not in (None, frame["stream"]):
                sys.exit("the publisher began anew: start this node and PL-VINS again, too")
            stream = frame["stream"]
            if frame["type"] == "tracks":  # other types may be added
                yield frame


def frame_of(data):
    """Type and stream of a message, and what is needed of `tracks`; docs/protocol.md describes it."""
    try:
        message = msgpack.unpackb(data)
        if message["version"] != 1:
            sys.exit(f"the stream has version {message['version']} of the protocol")
        frame = {"type": message["type"], "stream": message["stream"]}
        return frame if frame["type"] != "tracks" else {**frame, **tracks_of(message)}
    except Exception as error:  # whatever it is that came
        sys.exit(f"this is no message of `frontend.run --publish`: {error!r}")


def tracks_of(message):
    """Numbers and arrays of a `tracks` message."""
    if message["camera"] is None:
        sys.exit("PL-VINS needs normalized coordinates: give frontend.run the calibration with --calib FILE")
    index, stamp_ns, stride = message["frame_index"], message["stamp_ns"], message.get("stride", 1)
    if not (index >= 0 and 0 <= stamp_ns < 2**31 * 10**9 and stride >= 1):
        raise ValueError(f"frame {index} of stride {stride} at {stamp_ns} ns")
    tracks = {"frame_index": int(index), "stamp_ns": int(stamp_ns), "stride": int(stride)}
    camera = message["camera"]
    tracks["focal"] = float(camera["fx"]), float(camera["fy"])
    tracks["middle"] = camera["width"] // 2, camera["height"] // 2
    for first, arrays in (("ids", ARRAYS), ("point_ids", POINTS)):
        if first not in message["arrays"] and first == "point_ids":
            continue  # of a publisher from before there were points
        for name, (dtype, *shape) in arrays.items():
            array = message["arrays"][name]
            tracks[name] = np.frombuffer(array["data"], dtype).reshape(array["shape"])
            if array["dtype"] != dtype or tracks[name].shape != (len(tracks[first]), *shape):
                raise ValueError(f"array {name} is {array['dtype']} {array['shape']}")
    tracks["usable"] = np.isfinite(tracks["observed_normalized"]).all((1, 2))  # a lens model can end
    return tracks


def header_of(stamp_ns, frame_id):
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return Header(stamp=Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def cloud_of(stamp_ns, points, channels):
    """A cloud on the plane z = 1; PL-VINS reads channels by position."""
    return PointCloud(
        header=header_of(stamp_ns, "world"),
        points=[Point32(x=x, y=y, z=1.0) for x, y in points.tolist()],
        channels=[ChannelFloat32(name=name, values=values.tolist()) for name, values in channels.items()],
    )


def lines_of(stamp_ns, numbers, segments, focal=(1, 1), middle=(0, 0)):
    """PL-VINS's lines, with the pixels of its undistorted picture."""
    pixels = (segments * focal + middle).reshape(-1, 4)
    columns = np.column_stack([numbers, segments[:, 1], pixels]).astype(np.float32).T
    names = "id_of_line u_of_endpoint v_of_endpoint start_u_of_line start_v_of_line end_u_of_line end_v_of_line"
    return cloud_of(stamp_ns, segments[:, 0], dict(zip(names.split(), columns, strict=True)))


def points_of(stamp_ns, numbers, points, pixels, velocities):
    """PL-VINS's points, with the velocities of VINS-Mono's."""
    columns = np.column_stack([numbers, pixels, velocities]).astype(np.float32).T
    names = "id_of_point u_of_point v_of_point velocity_x_of_point velocity_y_of_point"
    return cloud_of(stamp_ns, points, dict(zip(names.split(), columns, strict=True)))


class Numbers:
    """Numbers for ids of consecutive clouds: PL-VINS wants no gaps, so one that was away gets a new number."""

    def __init__(self):
        self.given, self.next = {}, 0

    def of(self, ids):
        given = {}
        for one in ids:
            if one not in self.given:
                self.given[one], self.next = self.next, (self.next + 1) % 2**24
            given[one] = self.given[one]
        self.given = given
        return list(given.values())


class PlVinsClouds:
    """The clouds of each frame.

    Without points there is one for each message of PL-VINS's point tracker, which it pairs them with by order. That
    publishes every stride-th image, but not the first of all. So there is an empty cloud for each of them that is
    missing, between two frames or, if this node came late, before the first. With points there is a pair of clouds for
    each frame in which a point is seen again, and no other.
    """

    def __init__(self, points=False):
        self.points, self.lines_numbers, self.points_numbers = points, Numbers(), Numbers()
        self.before, self.sent = None, -1 if points else 0  # the frame before; image of the cloud before

    def of_frame(self, frame):
        """Clouds of lines, and of points."""
        index, stamp_ns, before, self.before = frame["frame_index"], frame["stamp_ns"], self.before, frame
        empty = [] if self.points else self.missing(frame, before)
        if index <= self.sent:
            return [], []
        points = self.moved(frame, before) if self.points else []
        if self.points and not points:
            return [], []
        self.sent = index
        chosen = (frame["states"] == 1) & frame["usable"]
        numbers = self.lines_numbers.of(frame["ids"][chosen].tolist())
        lines = lines_of(stamp_ns, numbers, frame["observed_normalized"][chosen], frame["focal"], frame["middle"])
        return [*empty, lines], points

    def missing(self, frame, before):
        index, stamp_ns, stride = frame["frame_index"], frame["stamp_ns"], frame["stride"]
        if index % stride:
            sys.exit(f"frame {index} is none that PL-VINS publishes, whose numbers {stride} divides: use no --start")
        images = range(self.sent + stride, index, stride)
        if len(images) > MOST_MISSING:
            sys.exit(f"{len(images)} images are missing before frame {index}: start this node before the frontend")
        if images:
            self.lines_numbers.of([])
        first, first_ns = (before["frame_index"], before["stamp_ns"]) if before else (0, max(0, stamp_ns - index))
        stamps = [first_ns + (stamp_ns - first_ns) * (image - first) // (index - first) for image in images]
        return [lines_of(one, [], np.zeros((0, 2, 2))) for one in stamps]

    def moved(self, frame, before):
        if before is None or frame["stamp_ns"] <= before["stamp_ns"]:
            return []
        if not len(frame.get("point_ids", ())) and not len(before.get("point_ids", ())):
            print(f"frame {frame['frame_index']} has no points: does frontend.run have --points?", file=sys.stderr)
            return []
        ids, rows, earlier = np.intersect1d(frame["point_ids"], before["point_ids"], True, return_indices=True)
        now = frame["points_normalized"]
        seconds = (frame["stamp_ns"] - before["stamp_ns"]) / 10**9
        velocities = (now[rows] - before["points_normalized"][earlier]) / seconds
        known = np.isfinite(velocities).all(1)
        if not known.any():
            return []
        numbers, rows = self.points_numbers.of(ids[known].tolist()), rows[known]
        return [points_of(frame["stamp_ns"], numbers, now[rows], frame["points_px"][rows], velocities[known])]


def markers_of(frame):
    """The stable lines one metre before the camera."""
    ends = frame["observed_normalized"][frame["stable"] & frame["usable"]].reshape(-1, 2).tolist()
    marker = Marker(header=header_of(frame["stamp_ns"], "camera"), ns="lines", type=Marker.LINE_LIST, action=Marker.ADD)
    marker.points = [Point(x=x, y=y, z=1.0) for x, y in ends]
    marker.scale, marker.color = Vector3(x=0.003), ColorRGBA(g=1.0, a=1.0)
    return MarkerArray(markers=[marker])


def main(address, points=False):
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C ends the loop below
    node = Node("airline_lines")
    of_lines = node.create_publisher(PointCloud, "/linefeature_tracker/linefeature", MOST_MISSING)
    of_points = node.create_publisher(PointCloud, "/feature_tracker/feature", MOST_MISSING) if points else None
    markers = node.create_publisher(MarkerArray, "/lines/markers", 10)
    clouds = PlVinsClouds(points)
    for frame in frames_from(address):
        lines, dots = clouds.of_frame(frame)
        for cloud in lines:
            of_lines.publish(cloud)
        for cloud in dots:
            of_points.publish(cloud)
        markers.publish(markers_of(frame))


if __name__ == "__main__":
    main(sys.argv[1], "--points" in sys.argv[2:])

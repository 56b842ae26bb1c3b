"""A ROS 2 node with lines for PL-VINS and RViz: `python3 ros2_lines_node.py tcp://127.0.0.1:5555`.

It publishes what `python -m frontend.run ... --publish tcp://127.0.0.1:5555` sends. It is one file that imports nothing
of that package, so Humble's Python 3.10 runs it, too: `apt install python3-zmq python3-msgpack python3-numpy`.
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
    """Type and stream of a message, and what is needed of `tracks`; docs/backends.md describes it."""
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
    for name, (dtype, *shape) in ARRAYS.items():
        array = message["arrays"][name]
        tracks[name] = np.frombuffer(array["data"], dtype).reshape(array["shape"])
        if array["dtype"] != dtype or tracks[name].shape != (len(tracks["ids"]), *shape):
            raise ValueError(f"array {name} is {array['dtype']} {array['shape']}")
    tracks["usable"] = np.isfinite(tracks["observed_normalized"]).all((1, 2))  # a lens model can end
    return tracks


def header_of(stamp_ns, frame_id):
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return Header(stamp=Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def cloud_of(stamp_ns, numbers, segments):
    """PL-VINS's layout."""
    starts, ends = segments[:, 0], segments[:, 1]
    channels = {"id_of_line": numbers, "u_of_endpoint": ends[:, 0].tolist(), "v_of_endpoint": ends[:, 1].tolist()}
    return PointCloud(
        header=header_of(stamp_ns, "world"),
        points=[Point32(x=x, y=y, z=1.0) for x, y in starts.tolist()],
        channels=[ChannelFloat32(name=name, values=values) for name, values in channels.items()],
    )


class PlVinsClouds:
    """The clouds of each frame, one for each message of PL-VINS's point tracker, which it pairs them with by order.

    That publishes every stride-th image, but not the first of all. So there is an empty cloud for each of them that is
    missing, between two frames or, if this node came late, before the first.
    """

    def __init__(self):
        self.numbers, self.next = {}, 0  # of the tracks in the cloud before, and of the next new one
        self.before, self.sent = None, 0  # index and stamp of the frame before; image of the cloud before

    def of_frame(self, frame):
        index, stamp_ns, stride = frame["frame_index"], frame["stamp_ns"], frame["stride"]
        if index % stride:
            sys.exit(f"frame {index} is none that PL-VINS publishes, whose numbers {stride} divides: use no --start")
        before, before_ns = self.before or (0, max(0, stamp_ns - index))
        self.before = index, stamp_ns
        missing = (index - self.sent) // stride - 1
        if missing < 0:
            return []
        if missing > MOST_MISSING:
            sys.exit(f"{missing} images are missing before frame {index}: start this node before the frontend")
        images, self.sent = range(self.sent + stride, index, stride), index
        if missing:
            self.numbers = {}
        chosen = (frame["states"] == 1) & frame["usable"]
        numbers = {}
        for track in frame["ids"][chosen].tolist():
            if track not in self.numbers:  # PL-VINS wants no gaps: a track that was lost gets a new number
                self.numbers[track], self.next = float(self.next), (self.next + 1) % 2**24
            numbers[track] = self.numbers[track]
        self.numbers = numbers
        none = np.zeros((0, 2, 2))
        stamps = [before_ns + (stamp_ns - before_ns) * (image - before) // (index - before) for image in images]
        clouds = [cloud_of(one, [], none) for one in stamps]
        return [*clouds, cloud_of(stamp_ns, list(numbers.values()), frame["observed_normalized"][chosen])]


def markers_of(frame):
    """The stable lines one metre before the camera."""
    ends = frame["observed_normalized"][frame["stable"] & frame["usable"]].reshape(-1, 2).tolist()
    marker = Marker(header=header_of(frame["stamp_ns"], "camera"), ns="lines", type=Marker.LINE_LIST, action=Marker.ADD)
    marker.points = [Point(x=x, y=y, z=1.0) for x, y in ends]
    marker.scale, marker.color = Vector3(x=0.003), ColorRGBA(g=1.0, a=1.0)
    return MarkerArray(markers=[marker])


def main(address):
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C ends the loop below
    node = Node("airline_lines")
    clouds = node.create_publisher(PointCloud, "/linefeature_tracker/linefeature", MOST_MISSING)
    markers = node.create_publisher(MarkerArray, "/lines/markers", 10)
    lines = PlVinsClouds()
    for frame in frames_from(address):
        for cloud in lines.of_frame(frame):
            clouds.publish(cloud)
        markers.publish(markers_of(frame))


if __name__ == "__main__":
    main(sys.argv[1])

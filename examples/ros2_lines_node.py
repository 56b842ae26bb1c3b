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
            yield frame


def frame_of(data):
    """A message, with its arrays; docs/backends.md describes it."""
    frame = msgpack.unpackb(data)
    if frame["version"] != 1:
        sys.exit(f"the stream has version {frame['version']} of the protocol")
    if frame["type"] == "tracks":
        if frame["camera"] is None:
            sys.exit("PL-VINS needs normalized coordinates: give frontend.run the calibration with --calib FILE")
        for name, array in frame["arrays"].items():
            frame[name] = np.frombuffer(array["data"], array["dtype"]).reshape(array["shape"])
        frame["usable"] = np.isfinite(frame["observed_normalized"]).all((1, 2))  # a lens model can end
    return frame


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

    So there is none for the first frame, and an empty one for each that is missing between two others.
    """

    def __init__(self):
        self.numbers, self.next = {}, 0  # of the tracks in the cloud before, and of the next new one
        self.before, self.stride = None, 0

    def of_frame(self, frame):
        index, stamp_ns = frame["frame_index"], frame["stamp_ns"]
        if self.before is None:  # more than none if this node came late
            count, before_ns = frame["sequence"], stamp_ns - frame["sequence"]
        else:
            step, before_ns = max(1, index - self.before[0]), self.before[1]
            self.stride = min(self.stride or step, step)
            count = step // self.stride
        self.before = index, stamp_ns
        if count == 0:
            return []
        if count > 1:
            self.numbers = {}
        chosen = (frame["states"] == 1) & frame["usable"]
        numbers = {}
        for track in frame["ids"][chosen].tolist():
            if track not in self.numbers:  # PL-VINS wants no gaps: a track that was lost gets a new number
                self.numbers[track], self.next = float(self.next), (self.next + 1) % 2**24
            numbers[track] = self.numbers[track]
        self.numbers = numbers
        none = np.zeros((0, 2, 2))
        clouds = [cloud_of(before_ns + (stamp_ns - before_ns) * k // count, [], none) for k in range(1, count)]
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
    clouds = node.create_publisher(PointCloud, "/linefeature_tracker/linefeature", 1000)
    markers = node.create_publisher(MarkerArray, "/lines/markers", 10)
    lines = PlVinsClouds()
    for frame in frames_from(address):
        for cloud in lines.of_frame(frame):
            clouds.publish(cloud)
        markers.publish(markers_of(frame))


if __name__ == "__main__":
    main(sys.argv[1])

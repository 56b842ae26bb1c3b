"""A ROS 2 node: `python examples/ros2_lines_node.py tcp://127.0.0.1:5555`.

It publishes a live stream as the point cloud that PL-VINS reads, and as markers for RViz. It needs this package and
`rclpy` in the same Python.
"""

import sys

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Point32, Vector3
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import ChannelFloat32, PointCloud
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from logs import subscribe_tracks
from logs.sinks.plvins import PlVinsLines


def header_of(tracks, frame_id):
    seconds, nanoseconds = divmod(tracks.stamp_ns, 10**9)
    return Header(stamp=Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def cloud_of(tracks, lines):
    """PL-VINS's layout; `lines` is the stream's `PlVinsLines`."""
    numbers, segments = lines.of_frame(tracks)
    starts, ends = segments[:, 0], segments[:, 1]
    channels = {"id_of_line": numbers, "u_of_endpoint": ends[:, 0], "v_of_endpoint": ends[:, 1]}
    return PointCloud(
        header=header_of(tracks, "world"),
        points=[Point32(x=x, y=y, z=1.0) for x, y in starts.tolist()],
        channels=[ChannelFloat32(name=name, values=values.tolist()) for name, values in channels.items()],
    )


def markers_of(tracks):
    """The stable lines one metre before the camera."""
    ends = tracks.observed_normalized[tracks.stable].reshape(-1, 2).tolist()
    marker = Marker(header=header_of(tracks, "camera"), ns="lines", type=Marker.LINE_LIST, action=Marker.ADD)
    marker.points = [Point(x=x, y=y, z=1.0) for x, y in ends]
    marker.scale, marker.color = Vector3(x=0.003), ColorRGBA(g=1.0, a=1.0)
    return MarkerArray(markers=[marker])


def main():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C ends the loop below
    node = Node("airline_lines")
    clouds = node.create_publisher(PointCloud, "/linefeature_tracker/linefeature", 1000)
    markers = node.create_publisher(MarkerArray, "/lines/markers", 10)
    lines = PlVinsLines()
    with subscribe_tracks(sys.argv[1], timeout_s=None) as subscription:
        for tracks in subscription:
            if subscription.lost:
                sys.exit("messages were lost: PL-VINS would pair lines and points of different frames from here on")
            clouds.publish(cloud_of(tracks, lines))
            markers.publish(markers_of(tracks))


if __name__ == "__main__":
    main()

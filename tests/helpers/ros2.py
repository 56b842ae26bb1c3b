"""Stand-ins for what examples/ros2_lines_node.py imports from ROS 2: messages that are as strict, and a node."""

from __future__ import annotations

import re
import runpy
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from tests.helpers.command import ROOT

NODE = ROOT / "examples" / "ros2_lines_node.py"
XYZ = dict.fromkeys("xyz", float)
FIELDS: dict[str, dict[str, Any]] = {  # a list for an array, a text for another message
    "Time": {"sec": int, "nanosec": int},
    "Header": {"stamp": "Time", "frame_id": str},
    "Point": XYZ,
    "Point32": XYZ,
    "Vector3": XYZ,
    "ColorRGBA": dict.fromkeys("rgba", float),
    "ChannelFloat32": {"name": str, "values": [float]},
    "PointCloud": {"header": "Header", "points": ["Point32"], "channels": ["ChannelFloat32"]},
    "Marker": {"header": "Header", "ns": str, "type": int, "action": int, "points": ["Point"], "scale": "Vector3"}
    | {"color": "ColorRGBA"},
    "MarkerArray": {"markers": ["Marker"]},
}


class Message(SimpleNamespace):
    """A message of ROS 2: it has these fields alone, of exactly these types."""

    LINE_LIST, ADD = 5, 0

    def __setattr__(self, name: str, value: Any) -> None:
        wanted = FIELDS[type(self).__name__][name]
        values = value if isinstance(wanted, list) else [value]
        wanted = wanted[0] if isinstance(wanted, list) else wanted
        assert all(type(one).__name__ == (wanted if isinstance(wanted, str) else wanted.__name__) for one in values)
        super().__setattr__(name, value)

    def __init__(self, **fields: Any) -> None:
        for name, value in fields.items():
            setattr(self, name, value)


class Node:
    """A node that keeps what is published, by topic."""

    sent: dict[str, list[Any]]

    def __init__(self, name: str) -> None:
        assert name.isidentifier()

    def create_publisher(self, kind: type, topic: str, depth: int) -> SimpleNamespace:
        sent = self.sent[topic] = []

        def publish(message: Any) -> None:
            assert type(message) is kind
            sent.append(message)

        return SimpleNamespace(publish=publish)


def load_node(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the example defines."""
    Node.sent = {}
    rclpy = ModuleType("rclpy")
    rclpy.__dict__.update(init=lambda **options: None)
    modules = {"rclpy": rclpy, "rclpy.node": SimpleNamespace(Node=Node)}
    modules["rclpy.signals"] = SimpleNamespace(SignalHandlerOptions=SimpleNamespace(NO=0))
    for package, names in re.findall(r"from (\w+_\w+\.msg) import (.*)", NODE.read_text(encoding="utf-8")):
        kinds = {name: type(name, (Message,), {}) for name in names.split(", ")}
        modules |= {package: SimpleNamespace(**kinds), package.split(".")[0]: SimpleNamespace()}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(NODE), run_name="lines_node")

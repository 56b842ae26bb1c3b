"""docs/backends.md has the tables of the code, and the ROS 2 node makes the messages of PL-VINS's file."""

from __future__ import annotations

import re
import runpy
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from logs.sinks.plvins import TOPIC, PlVinsLines, PlVinsTrackSink
from logs.tracks.message import ARRAYS, encode
from tests.helpers.command import ROOT
from tests.helpers.made_tracks import clip_results, write_tracks
from tests.logs.test_plvins import read

PAGE = (ROOT / "docs" / "backends.md").read_text(encoding="utf-8")
NODE = ROOT / "examples" / "ros2_lines_node.py"


class Message(SimpleNamespace):
    """Stands in for any message class of ROS 2: they take their fields by name."""

    LINE_LIST, ADD = 5, 0


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the example defines, with stand-ins for what it imports from ROS."""
    source = NODE.read_text(encoding="utf-8")
    for package, names in re.findall(r"from ((?:\w+_\w+\.msg)|rclpy\.\w+) import (.*)", source):
        module = ModuleType(package)
        module.__dict__.update(dict.fromkeys(names.split(", "), Message))
        monkeypatch.setitem(sys.modules, package, module)
        monkeypatch.setitem(sys.modules, package.split(".")[0], ModuleType(package.split(".")[0]))
    return runpy.run_path(str(NODE), run_name="lines_node")


def test_the_node_sends_what_the_file_holds(node: dict[str, Any], tmp_path) -> None:
    write_tracks(PlVinsTrackSink(tmp_path / "plvins.mcap"), clip_results())
    lines = PlVinsLines()
    expected = [cloud for *_, cloud in read(tmp_path / "plvins.mcap")]
    assert f'"{TOPIC}"' in NODE.read_text(encoding="utf-8")
    assert sum(len(cloud.points) for cloud in expected) > 500
    for result, cloud in zip(clip_results(), expected, strict=True):
        found = node["cloud_of"](result.tracks, lines)
        stamp = cloud.header.stamp
        assert (found.header.stamp.sec, found.header.stamp.nanosec) == (stamp.secs, stamp.nsecs)
        assert found.header.frame_id == cloud.header.frame_id
        assert [(p.x, p.y, p.z) for p in found.points] == [(p.x, p.y, p.z) for p in cloud.points]
        channels = [[(one.name, list(one.values)) for one in each.channels] for each in (found, cloud)]
        assert channels[0] == channels[1]


def test_the_markers_are_the_stable_lines(node: dict[str, Any]) -> None:
    tracks = clip_results()[6].tracks
    (marker,) = node["markers_of"](tracks).markers
    points = np.array([(point.x, point.y, point.z) for point in marker.points], np.float32)
    assert tracks.observed_normalized is not None
    np.testing.assert_array_equal(points[:, :2], tracks.observed_normalized[tracks.stable].reshape(-1, 2))
    assert len(points) > 20
    assert (points[:, 2] == 1).all()


def test_the_tables_are_those_of_the_protocol() -> None:
    message = msgspec.msgpack.decode(encode(clip_results()[0], stream=0, sequence=0, name="", sent_ns=0))
    fields = re.findall(r"^\| `(\w+)` \| (?:int|str|map|\[int)", PAGE, re.MULTILINE)
    assert sorted(fields) == sorted(message)
    rows = []
    for field in ARRAYS:  # to paste into the page when a field was added
        shape, meaning = field.text.removeprefix("(").split(") ", 1)
        dtype = message["arrays"][field.name]["dtype"].replace("|", "\\|")
        rows.append(f"| `{field.name}` | `{dtype}` | {shape} | {meaning} |")
    assert re.findall(r"^\| `\w+` \| `.*", PAGE, re.MULTILINE) == rows

"""docs/protocol.md has the tables of the code, and the ROS 2 node makes the messages of PL-VINS's file."""

from __future__ import annotations

import ast
import re
import threading
from contextlib import closing
from typing import Any

import msgspec
import numpy as np
import pytest
import zmq

from frontend.tracks import LineTracks
from logs.sinks.open import open_publisher
from logs.sinks.plvins import VinsSink
from logs.tracks.message import ARRAYS, encode
from tests.helpers.command import ROOT
from tests.helpers.made_tracks import FISHEYE, clip_results, made_tracks, result_of, write_tracks
from tests.helpers.plvins import TOPIC, clouds_of, read_bag
from tests.helpers.ros2 import NODE, Node, load_node

PAGE = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    return load_node(monkeypatch)


def frame_of(node: dict[str, Any], tracks: LineTracks) -> dict[str, Any]:
    frame: dict[str, Any] = node["frame_of"](encode(result_of(tracks), stream=0, sequence=0, name="", sent_ns=0))
    return frame


def test_the_node_publishes_what_the_file_holds(node: dict[str, Any], tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("logs.sinks.zeromq.CONNECT_S", 1.0)  # the machine may be busy
    write_tracks(VinsSink(tmp_path / "lines.bag"), clip_results())
    with closing(open_publisher("tcp://127.0.0.1:0", "clip")) as publisher:
        thread = threading.Thread(target=write_tracks, args=(publisher, clip_results()))
        thread.start()
        node["main"](publisher.address)
        thread.join()
    clouds = clouds_of(Node.sent[TOPIC])
    assert clouds == read_bag(tmp_path / "lines.bag")
    assert sum(len(lines) for _, lines in clouds) > 500
    assert len(Node.sent["/lines/markers"]) == len(clip_results())


def test_the_markers_are_the_stable_lines(node: dict[str, Any]) -> None:
    tracks = clip_results()[6].tracks
    (marker,) = node["markers_of"](frame_of(node, tracks)).markers
    points = np.array([(point.x, point.y, point.z) for point in marker.points], np.float32)
    assert tracks.observed_normalized is not None
    np.testing.assert_array_equal(points[:, :2], tracks.observed_normalized[tracks.stable].reshape(-1, 2))
    assert len(points) > 20
    assert (points[:, 2] == 1).all()


def test_rviz_gets_no_line_that_no_undistortion_reaches(node: dict[str, Any]) -> None:
    """It shows nothing of a marker with NaN."""
    tracks = made_tracks(0, 0, np.arange(9), np.random.default_rng(0), camera=FISHEYE)
    tracks.stable[:] = True
    tracks.observed_px[2, 1] = 1e5
    (marker,) = node["markers_of"](frame_of(node, tracks)).markers
    assert len(marker.points) == 16
    assert np.isfinite([point.x for point in marker.points]).all()


def test_the_node_says_what_it_cannot_use(node: dict[str, Any]) -> None:
    with pytest.raises(SystemExit, match="--calib"):
        frame_of(node, made_tracks(0, 0, np.arange(9), np.random.default_rng(0), camera=None))
    with pytest.raises(SystemExit, match="version 2"):
        node["frame_of"](msgspec.msgpack.encode({"version": 2}))


def good(**changes: Any) -> dict[str, Any]:
    """A message's fields."""
    tracks = made_tracks(3, 8, np.arange(9), np.random.default_rng(0))
    data = encode(result_of(tracks), stream=7, sequence=0, name="", sent_ns=0)
    return {**msgspec.msgpack.decode(data), **changes}


def with_array(name: str, **changes: Any) -> dict[str, Any]:
    message = good()
    message["arrays"][name].update(changes)
    return message


NO_MESSAGES = [
    *(b"", b"\xc1", b"noise", b"\xdd\xff\xff\xff\xff", b"\x91" * 100_000),
    *map(msgspec.msgpack.encode, ([], [1, "tracks"], None, 1, "version", {}, {"version": 1}, {1: 2}, {"stream": 7})),
    *map(msgspec.msgpack.encode, ({"version": 1, "type": "tracks"}, {"version": 1, "type": "end"})),
    *(msgspec.msgpack.encode(good())[:size] for size in (1, 100, 1000, -1)),
    msgspec.msgpack.encode(good()) + b"\0",
    *(
        msgspec.msgpack.encode(good(**{name: value}))
        for name, values in {
            "frame_index": (None, "3", -1, []),
            "stamp_ns": (None, -1, 2**31 * 10**9, float("nan")),
            "stride": (None, 0, "2"),
            "arrays": (None, [], {}),
        }.items()
        for value in values
    ),
    *(
        msgspec.msgpack.encode(with_array(*change[:1], **{change[1]: change[2]}))
        for change in [
            *(
                ("ids", "data", bytes(8)),
                ("ids", "dtype", "<f8"),
                ("ids", "dtype", "nonsense"),
                ("ids", "shape", [3, 3]),
            ),
            *(("states", "data", None), ("stable", "shape", []), ("stable", "shape", [2**62]), ("ids", "shape", "9")),
            ("observed_normalized", "shape", [9, 4]),
        ]
    ),
]


@pytest.mark.parametrize("data", NO_MESSAGES, ids=range(len(NO_MESSAGES)))
def test_the_node_ends_with_a_sentence_for_what_is_no_message(node: dict[str, Any], data: bytes) -> None:
    with pytest.raises(SystemExit) as ended:
        node["frame_of"](data)
    assert str(ended.value).startswith("this is no message of `frontend.run --publish`: ")
    assert "\n" not in str(ended.value)


def test_the_node_passes_over_what_later_programs_send(node: dict[str, Any]) -> None:
    first, second, end = good(), good(frame_index=4, stamp_ns=9, colour="red"), good(type="end")
    del first["stride"], end["arrays"]
    messages = [good(type="status", arrays=3), first, good(type=2), second, {**good(type="poses"), "camera": None}, end]
    sent = iter(map(msgspec.msgpack.encode, messages))
    with zmq.Context() as context, context.socket(zmq.XPUB) as publisher:
        port = publisher.bind_to_random_port("tcp://127.0.0.1")
        thread = threading.Thread(target=lambda: publisher.recv() and [publisher.send(one) for one in sent])
        thread.start()
        frames = list(node["frames_from"](f"tcp://127.0.0.1:{port}"))
        thread.join()
    assert [(frame["frame_index"], frame["stride"]) for frame in frames] == [(3, 1), (4, 1)]


def test_the_node_needs_nothing_that_humble_does_not_have() -> None:
    """Its Python is 3.10, and this package needs 3.11."""
    tree = ast.parse(NODE.read_text(encoding="utf-8"), feature_version=(3, 10))
    imported = {name.name for one in ast.walk(tree) if isinstance(one, ast.Import) for name in one.names}
    imported |= {str(one.module).split(".")[0] for one in ast.walk(tree) if isinstance(one, ast.ImportFrom)}
    messages = {"builtin_interfaces", "geometry_msgs", "sensor_msgs", "std_msgs", "visualization_msgs"}
    assert imported == {"sys", "msgpack", "numpy", "zmq", "rclpy"} | messages


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

"""Two topics of a log as a pair: out of order, with messages missing on either side, and with their calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags import rosbag1, rosbag2

from airline.errors import InputError
from frontend import open_stereo
from frontend.cli import wiring
from frontend.cli.settings import InputConfig, RunConfig
from frontend.sources.pairs import partner_of
from logs import open_images
from tests.helpers.camera_logs import EPOCH_NS, STEP_NS, Channel, Logged, write_log
from tests.helpers.camera_messages import ROS1, ROS2, image_fields, ros
from tests.helpers.command import command, refusal
from tests.helpers.rigs import kalibr as kalibr_of
from tests.helpers.rigs import rectification, rig, write

LEFT, RIGHT = "/cam0/image_raw", "/cam1/image_raw"
Times = dict[str, list[int]]  # numbers of the frames by topic, in the order of the log


def image(number: int, topic: str) -> np.ndarray:
    return np.full((48, 64), 2 * number + (topic == RIGHT), np.uint8)


def messages(store, kind: str, stamp_ns: int, **fields) -> bytes:
    message = ros(store, kind, stamp_ns, **fields)
    name = f"sensor_msgs/msg/{kind}"
    return bytes(store.serialize_ros1(message, name) if store is ROS1 else store.serialize_cdr(message, name))


def pictures(times: Times, store) -> dict[str, list[Logged]]:
    """Messages logged in the order of the lists, each when the latest of all so far was taken."""
    found = {}
    for topic, numbers in times.items():
        latest, rows = 0, []
        for place, number in enumerate(numbers):
            stamp_ns = EPOCH_NS + number * STEP_NS + 3_000_000 * (topic == RIGHT)
            latest = max(latest, stamp_ns)
            fields = image_fields(image(number, topic).tobytes(), 64, 48, "mono8", 64)
            rows.append(Logged(latest + place, messages(store, "Image", stamp_ns, **fields)))
        found[topic] = rows
    return found


def write_pair(path: Path, kind: str, times: Times) -> Path:
    """A log of two cameras, MCAP or a bag."""
    if kind == "MCAP":
        channels = {t: Channel("sensor_msgs/msg/Image", "cdr", rows) for t, rows in pictures(times, ROS2).items()}
        return write_log(path / "pair.mcap", channels)
    store = ROS1 if kind == "ROS 1" else ROS2
    file = path / ("pair.bag" if store is ROS1 else "bag")
    with rosbag1.Writer(file) if store is ROS1 else rosbag2.Writer(file, version=9) as writer:
        topics = {t: writer.add_connection(t, "sensor_msgs/msg/Image", typestore=store) for t in times}
        for log_ns, topic, data in sorted(
            (one.log_ns, topic, one.data) for topic, rows in pictures(times, store).items() for one in rows
        ):
            writer.write(topics[topic], log_ns, data)
    return file


orders = st.lists(
    st.tuples(st.sampled_from(["both", "both", "left", "right"]), st.integers(0, 3), st.integers(0, 3)),
    min_size=6,
    max_size=24,
)


def times_of(moments: list[tuple[str, int, int]]) -> Times:
    """Frames that are there, each logged up to three frames late."""
    found: Times = {}
    for topic, side, late in ((LEFT, "left", 1), (RIGHT, "right", 2)):
        there = [number for number, moment in enumerate(moments) if moment[0] in ("both", side)]
        found[topic] = sorted(there, key=lambda number: number + moments[number][late])
    return found


@pytest.mark.parametrize("kind", ["MCAP", "ROS 1", "ROS 2"])
@given(moments=orders)
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_all_pairs_that_exist_and_counts_that_add_up(
    tmp_path_factory: pytest.TempPathFactory, kind: str, moments: list[tuple[str, int, int]]
) -> None:
    times = times_of([("both", 0, 0)] * 3 + moments)
    log = write_pair(tmp_path_factory.mktemp("log"), kind, times)
    settings = InputConfig(stereo=True, rectified=True)
    source = wiring.open_input(str(log), RunConfig(input=settings))
    frames = list(source)
    both = sorted(set(times[LEFT]) & set(times[RIGHT]))
    assert [frame.stamp_ns for frame in frames] == [EPOCH_NS + number * STEP_NS for number in both]
    for frame, number in zip(frames, both, strict=True):
        assert frame.right is not None
        assert (frame.image[0, 0], frame.right[0, 0]) == (2 * number, 2 * number + 1)
    assert source.skipped == 0
    assert source.unpaired == tuple(len(times[topic]) - len(both) for topic in (LEFT, RIGHT))
    source.close()


def test_a_run_on_two_topics(tmp_path: Path) -> None:
    log = write_pair(tmp_path, "MCAP", {LEFT: [*range(8)], RIGHT: [1, 0, 3, 2, 5, 6, 7]})
    summary = tmp_path / "s.json"
    flags = "--topic", LEFT, "--right-topic", RIGHT, "--rectified", "--headless", "--summary", summary
    done = command(log, *flags, "--out", tmp_path / "t.parquet")
    assert done.code == 0, done.err
    for text in (LEFT, RIGHT, "7 (1 unpaired of the left)", "2 messages that were logged late"):
        assert text in done.out
    ours = open_stereo(open_images(log, LEFT), open_images(log, RIGHT), rectified=True)
    assert len(list(ours)) == 7


def test_the_logs_own_calibration(tmp_path: Path) -> None:
    cameras = rig()
    size = (64, 48)
    channels = {}
    times = {LEFT: [0, 1], RIGHT: [0, 1]}
    for topic, rows in pictures(times, ROS2).items():
        channels[topic] = Channel("sensor_msgs/msg/Image", "cdr", rows)
    for topic, camera, (r, p) in zip((LEFT, RIGHT), cameras, rectification(*cameras), strict=True):
        fields = {"d": np.append(camera.coefficients, 0.0), "k": camera.matrix.ravel(), "r": r.ravel(), "p": p.ravel()}
        fields |= {"height": 480, "width": 640, "distortion_model": "plumb_bob", "binning_x": 0, "binning_y": 0}
        fields |= {"roi": ROS2.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)}
        info = Logged(EPOCH_NS, messages(ROS2, "CameraInfo", EPOCH_NS, **fields))
        channels[topic.replace("image_raw", "camera_info")] = Channel("sensor_msgs/msg/CameraInfo", "cdr", [info])
    log = write_log(tmp_path / "pair.mcap", channels)
    chain = write(tmp_path / "camchain.yaml", kalibr_of(*cameras))
    found = []
    for calib in (None, str(chain)):
        source = wiring.open_input(str(log), RunConfig(input=InputConfig(stereo=True, calib=calib)))
        camera = next(iter(source)).camera
        source.close()
        assert camera is not None
        found.append(camera)
    assert (found[0].width, found[0].height) == size
    for name in ("fx", "fy", "cx", "cy", "baseline_m"):
        assert getattr(found[0], name) == pytest.approx(getattr(found[1], name), rel=1e-4)
    assert found[0].baseline_m == pytest.approx(np.linalg.norm([0.12, 0.006, 0.004]))


def test_topics_that_do_not_tell(tmp_path: Path) -> None:
    rows = pictures({LEFT: [0], RIGHT: [0]}, ROS2)

    def log(name: str, *topics: str) -> Path:
        channels = {topic: Channel("sensor_msgs/msg/Image", "cdr", rows[LEFT]) for topic in topics}
        return write_log(tmp_path / name, channels)

    several = log("several.mcap", LEFT, RIGHT, "/left/image", "/right/image")
    assert "several pairs" in refusal(several, "--stereo", "--info")
    assert partner_of("/left/image") == "/right/image"
    done = command(several, "--stereo", "--topic", "/left/image", "--rectified", "--info")
    assert done.code == 0, done.err
    unnamed = log("unnamed.mcap", "/a", "/b")
    said = refusal(unnamed, "--stereo", "--info")
    assert "shows no pair" in said
    assert "--right-topic" in said
    with pytest.raises(InputError, match="no messages on topic"):
        list(wiring.open_input(str(unnamed), RunConfig(input=InputConfig(topic="/a", right_topic="/c"))))

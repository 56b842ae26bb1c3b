"""The command line on logs: topics, calibration, outputs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from frontend.camera.model import CameraModel
from logs import read_tracks
from tests.helpers.camera_logs import Channel, Logged, text, write_log
from tests.helpers.camera_messages import ROS2, cdr, info_fields, rendered
from tests.helpers.command import command, recorded, refusal
from tests.helpers.plvins import read_bag, read_messages

EPOCH_NS = 1_700_000_000 * 10**9
STEP_NS = 33_333_333
FRAMES = 6
SIZE = 160, 120


def small_log(path: Path, *topics: str, calibrated: bool = True) -> Path:
    """A camera that pans over the rendered corridor."""
    picture = cv2.resize(rendered(), (SIZE[0] + FRAMES, SIZE[1]), interpolation=cv2.INTER_AREA)
    channels = {"/chatter": text()}
    for topic in topics:
        messages = []
        for number in range(FRAMES):
            stamp_ns = EPOCH_NS + number * STEP_NS
            data = cv2.imencode(".png", np.ascontiguousarray(picture[:, number : number + SIZE[0]]))[1]
            messages.append(Logged(stamp_ns + 5, cdr("CompressedImage", stamp_ns=stamp_ns, format="png", data=data)))
        channels[topic] = Channel("sensor_msgs/msg/CompressedImage", "cdr", messages)
    if calibrated:
        roi = ROS2.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        fields = {**info_fields(ROS2), "binning_x": 0, "binning_y": 0, "roi": roi}
        info = [Logged(EPOCH_NS, cdr("CameraInfo", **fields))]
        channels["/cam/camera_info"] = Channel("sensor_msgs/msg/CameraInfo", "cdr", info)
    return write_log(path, channels)


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_tracks_in_every_format(desk: Path) -> None:
    small_log(desk / "drive.mcap", "/cam/image")
    outputs = ["tracks.mcap", "tracks.parquet", "tracks.csv", "limap/", "plvins.mcap", "lines.bag"]
    flags = [flag for name in outputs for flag in ("--out", name)]
    outcome = command("drive.mcap", "--headless", *flags, "--with-images", "--labels")
    assert outcome.code == 0, outcome.err
    assert all(f"wrote {name}" in outcome.out for name in outputs)
    assert not (desk / "drive.rrd").exists()  # with --out, a recording is made on demand
    from_mcap, from_table = list(read_tracks(desk / "tracks.mcap")), list(read_tracks(desk / "tracks.parquet"))
    assert len(from_mcap) == len(from_table) == FRAMES
    for number, (one, other) in enumerate(zip(from_mcap, from_table, strict=True)):
        assert one.stamp_ns == other.stamp_ns == EPOCH_NS + number * STEP_NS
        np.testing.assert_array_equal(one.ids, other.ids)
        np.testing.assert_array_equal(one.segments_px, other.segments_px)
        assert isinstance(one.camera, CameraModel)
        assert one.camera.fx == pytest.approx(500 * SIZE[0] / 640)
    assert len((desk / "tracks.csv").read_text().splitlines()) == 1 + sum(map(len, from_mcap))

    assert "--overwrite" in refusal("drive.mcap", "--headless", *flags)
    assert command("drive.mcap", "--headless", *flags, "--overwrite", "--max-frames", 2).code == 0
    assert len(list(read_tracks(desk / "tracks.mcap"))) == 2


def test_several_cameras(desk: Path) -> None:
    small_log(desk / "drive.mcap", "/left/image", "/right/image")
    assert "--topic: /left/image" in refusal("drive.mcap", "--headless")
    listed = command("drive.mcap", "--list-topics")
    assert listed.code == 0
    heading, left, right, info = (line.split() for line in listed.out.splitlines())
    assert heading == ["topic", "type", "messages", "rate", "size"]
    assert left == ["/left/image", "sensor_msgs/msg/CompressedImage", "as", "cdr", "6", "30.0", "Hz", "160x120"]
    assert (right[0], info[0], info[-1]) == ("/right/image", "/cam/camera_info", "640x480")


def test_listing_without_a_camera_or_a_log(desk: Path, clip: Path) -> None:
    write_log(desk / "drive.mcap", {"/chatter": text()})
    for arguments in (["drive.mcap"], ["drive.mcap", "--list-topics"]):
        assert "no image topic; it holds /chatter (std_msgs/msg/String as cdr, 3 messages)" in refusal(*arguments)
    assert "is no log" in refusal(clip, "--list-topics")
    assert "needs a log" in refusal("--list-topics")


def test_calibration_file_and_undistortion(desk: Path, clip: Path) -> None:
    camera = {"width": 160, "height": 120, "fx": 120, "fy": 120, "cx": 79.5, "cy": 59.5}
    lens = {"distortion": "radial-tangential", "coefficients": [-0.2, 0.03, 0, 0]}
    Path("camera.json").write_text(json.dumps({**camera, **lens}))
    assert command(clip, "--headless", "--calib", "camera.json", "--out", "bent.parquet").code == 0
    bent = list(read_tracks("bent.parquet"))
    assert all(tracks.camera is not None and tracks.camera.distortion == "radial-tangential" for tracks in bent)
    assert command(clip, "--headless", "--calib", "camera.json", "--undistort", "--out", "straight.parquet").code == 0
    straight = list(read_tracks("straight.parquet"))
    assert all(tracks.camera is not None and tracks.camera.distortion == "none" for tracks in straight)
    assert not np.array_equal(bent[0].segments_px, straight[0].segments_px)
    for flags, hint in (
        (["--undistort"], "--calib"),
        (["--calib", "missing.yaml"], "missing.yaml"),
        (["--out", "plvins.mcap"], "--calib"),
        (["--calib", "camera.json", "--out", "uvslam.bag"], "--points"),
    ):
        refused = command(clip, "--headless", *flags)
        assert (refused.code, refused.err.count("\n")) == (2, 1), refused
        assert hint in refused.err


def test_points_for_pl_vins_and_its_kin(desk: Path, clip: Path) -> None:
    Path("camera.json").write_text('{"width": 160, "height": 120, "fx": 120, "fy": 120, "cx": 79.5, "cy": 59.5}')
    topics = {"plvins.bag": "/feature_tracker/feature", "eplf.mcap": "/lf_feature_tracker/feature"}
    topics["uvslam.bag"] = topics["plvins.bag"]
    flags = [flag for name in topics for flag in ("--out", name)]
    assert command(clip, "--headless", "--calib", "camera.json", "--points", *flags).code == 0
    for name, topic in topics.items():
        clouds = [cloud for one, cloud in read_messages(desk / name) if one == topic]
        assert [len(cloud.points) > 20 for cloud in clouds] == [True] * (len(list(clip.iterdir())) - 1)


@pytest.mark.parametrize("start_s", [0, 0.19])
def test_pl_vins_gets_a_message_of_every_image_of_the_stride(desk: Path, clip: Path, start_s: float) -> None:
    """Two images cannot be read, the first among them."""
    images = sorted(Path(shutil.copytree(clip, "images")).iterdir())
    for number in (0, 4):
        images[number].write_bytes(b"no image")
    Path("camera.json").write_text('{"width": 160, "height": 120, "fx": 120, "fy": 120, "cx": 79.5, "cy": 59.5}')
    flags = ("--headless", "--calib", "camera.json", "--stride", 2, "--start", start_s, "--out", "lines.bag")
    assert command("images", *flags).code == 0
    six_ns, two_ns = round(6e9 / 30), round(2e9 / 30)
    expected = [six_ns - 4, six_ns - 2, six_ns] if start_s else [two_ns, (two_ns + six_ns) // 2, six_ns]
    assert [stamp_ns for stamp_ns, _ in read_bag(desk / "lines.bag")] == expected


def test_time_source_and_start(desk: Path) -> None:
    small_log(desk / "drive.mcap", "/cam/image")
    flags = ("--headless", "--save", "run.rrd", "--time-source", "log", "--start", 0.1)
    assert command("drive.mcap", *flags).code == 0
    tracks = recorded(desk / "run.rrd")["/camera/tracks"]
    assert tracks["sensor_time"] == [EPOCH_NS + 5 + number * STEP_NS for number in range(4, FRAMES)]
    assert tracks["frame"] == list(range(4, FRAMES))


@pytest.mark.parametrize("name", ["tracks", "tracks.txt", "nowhere/tracks.mcap", "drive.mcap"])
def test_outputs_that_cannot_be(desk: Path, name: str) -> None:
    log = small_log(desk / "drive.mcap", "/cam/image")
    content = log.read_bytes()
    for flags in (["--out", name], ["--out", f"./{name}", "--overwrite"] if name == "drive.mcap" else ["--out", name]):
        assert ("it is the input" in refusal("drive.mcap", "--headless", *flags)) == ("--overwrite" in flags)
    assert log.read_bytes() == content
    assert "a.csv" in refusal("drive.mcap", "--headless", "--out", "a.csv", "--out", "./a.csv")


@pytest.mark.parametrize("names", [("u.csv", "u.frames.csv"), ("u.parquet", "csv:u.parquet.unfinished")])
def test_two_outputs_of_one_file(desk: Path, names: tuple[str, str]) -> None:
    log, (first, second) = small_log(desk / "drive.mcap", "/cam/image"), names
    for one, other in ((first, second), (second, first)):
        error = refusal(log.name, "--headless", "--out", one, "--out", other, "--overwrite")
        assert "another output" in error
    assert [path.name for path in desk.iterdir()] == [log.name]


def test_a_list_of_frames_that_is_there_is_found_first(desk: Path) -> None:
    small_log(desk / "drive.mcap", "/cam/image")
    (desk / "tracks.frames.csv").write_text("mine")
    assert "exists" in refusal("drive.mcap", "--headless", "--out", "a.parquet", "--out", "tracks.csv")
    assert {path.name for path in desk.iterdir()} == {"drive.mcap", "tracks.frames.csv"}

"""Frames out of logs: topics, times, seeking, calibration, and what cannot be decoded."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from airline.errors import InputError
from frontend.protocols import Source
from frontend.sources.wrapped import SelectedFrames
from logs import LogImageSource, McapImageSource, open_images
from logs.files import open_log
from logs.stamps import TimeSource
from logs.topics import as_text, camera_topics
from tests.helpers.camera_logs import EPOCH_NS, STEP_NS, Channel, Logged, drawn, images, raw, text, write_log
from tests.helpers.camera_messages import ROS2, K, cdr, info_fields
from tests.logs.test_log_video import FORMATS, GROUP, stream

COUNT = 12


def calibration(topic_width: int = 8, topic_height: int = 6) -> Channel:
    fields = {**info_fields(ROS2), "width": topic_width, "height": topic_height, "binning_x": 0, "binning_y": 0}
    fields["roi"] = ROS2.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    return Channel("sensor_msgs/msg/CameraInfo", "cdr", [Logged(EPOCH_NS, cdr("CameraInfo", **fields))])


@pytest.mark.parametrize("kind", ["Image", "CompressedImage"])
def test_whole_log(tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture) -> None:
    path = write_log(tmp_path / "drive.mcap", {"/camera": images(COUNT, kind=kind), "/chatter": text()})
    source = McapImageSource(path)
    assert isinstance(source, Source)
    assert source.first_stamp_ns is not None
    assert (source.name, source.frame_count, source.first_stamp_ns) == ("drive", COUNT, EPOCH_NS)
    frames = list(source)
    source.close()
    assert [frame.index for frame in frames] == list(range(COUNT))
    assert [frame.stamp_ns for frame in frames] == [EPOCH_NS + number * STEP_NS for number in range(COUNT)]
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, drawn(number))
        assert frame.camera is None
    assert source.skipped == 0
    assert not caplog.records


@pytest.mark.parametrize(
    ("time_source", "expected"), [("header", EPOCH_NS + 5), ("publish", EPOCH_NS + 7), ("log", EPOCH_NS + 9)]
)
def test_time_source(tmp_path: Path, time_source: TimeSource, expected: int) -> None:
    message = Logged(EPOCH_NS + 9, raw(0, EPOCH_NS + 5), EPOCH_NS + 7)
    path = write_log(tmp_path / "a.mcap", {"/camera": Channel("sensor_msgs/msg/Image", "cdr", [message])})
    (frame,) = McapImageSource(path, time_source=time_source)
    assert frame.stamp_ns == expected


def test_headers_without_time_fall_back_to_the_log(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    messages = [Logged(EPOCH_NS + number, raw(number, 0)) for number in range(3)]
    path = write_log(tmp_path / "a.mcap", {"/camera": Channel("sensor_msgs/msg/Image", "cdr", messages)})
    assert [frame.stamp_ns for frame in McapImageSource(path)] == [EPOCH_NS, EPOCH_NS + 1, EPOCH_NS + 2]
    assert [record.levelname for record in caplog.records] == ["WARNING"]


def test_choice_of_topic(tmp_path: Path) -> None:
    topics = {"/left": images(1), "/right": images(2, kind="CompressedImage"), "/chatter": text()}
    path = write_log(tmp_path / "a.mcap", topics)
    with pytest.raises(InputError, match=r"--topic: /left \(sensor_msgs/msg/Image as cdr, 1 messages\), /right"):
        McapImageSource(path)
    assert [len(list(McapImageSource(path, topic))) for topic in ("/left", "/right")] == [1, 2]
    with pytest.raises(InputError, match="its image topics are /left"):
        McapImageSource(path, topic="/middle")
    with pytest.raises(InputError, match=r"/chatter \(std_msgs/msg/String as cdr, 3 messages\) is no image"):
        McapImageSource(path, topic="/chatter")


def test_no_camera(tmp_path: Path) -> None:
    topics = {f"/topic{number}": text(1) for number in range(8)}
    with pytest.raises(InputError, match=r"no image topic; it holds /topic0 .*3 more; --list-topics"):
        McapImageSource(write_log(tmp_path / "a.mcap", topics))
    unknown = Channel("foxglove.RawImage", "flatbuffer", [Logged(1, b"x")])
    path = write_log(tmp_path / "b.mcap", {"/camera": unknown})
    with pytest.raises(InputError, match=r"not readable: /camera .*flatbuffer"):
        McapImageSource(path)
    with pytest.raises(InputError, match="is not readable"):
        McapImageSource(path, topic="/camera")
    with pytest.raises(InputError, match="no readable messages"):
        McapImageSource(write_log(tmp_path / "c.mcap", {}))


def test_undecodable_messages_are_counted_by_reason(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    times = [EPOCH_NS + number for number in range(8)]
    good = [raw(number, time) for number, time in enumerate(times)]
    wrong_type = Channel("foxglove.RawImage", "json", [Logged(times[6], b"{}")])
    data = [*good[:6], good[7]]
    data[1] = raw(1, times[1], "ycbcr9")
    data[2] = raw(2, times[2], "ycbcr9")
    data[3] = good[3][:-5]
    data[4] = raw(4, 0)  # no time: the log's clock counts
    data[5] = data[4]  # repeats the one before
    messages = [Logged(time, bytes_) for time, bytes_ in zip([*times[:6], times[7]], data, strict=True)]
    path = write_log(tmp_path / "a.mcap", {"/camera": Channel("sensor_msgs/msg/Image", "cdr", messages)})
    source = McapImageSource(path)
    assert [(frame.index, frame.stamp_ns) for frame in source] == [(0, times[0]), (4, times[4]), (6, times[7])]
    assert source.skipped == 4
    (skipped,) = [record.getMessage() for record in caplog.records if "skipped" in record.getMessage()]
    assert "skipped 4 frames" in skipped
    assert "2 x image encoding is not readable" in skipped
    assert "first: message 1 on /camera: image encoding is not readable: 'ycbcr9'" in skipped

    only_bad = [Logged(times[1], data[1]), Logged(times[3], data[3])]
    path = write_log(tmp_path / "b.mcap", {"/camera": Channel("sensor_msgs/msg/Image", "cdr", only_bad)})
    with pytest.raises(InputError, match="not one image of 'b' can be read; message 0"):
        list(McapImageSource(path))
    path = write_log(tmp_path / "c.mcap", {"/camera": wrong_type})
    with pytest.raises(InputError, match="not one image"):
        list(McapImageSource(path))


@pytest.mark.parametrize("late_ns", [0, 30_000_000, -20_000_000])
@pytest.mark.parametrize("start_s", [0.0, 0.05, 1.25, 4.0, 5.9, 7.0])
def test_seek(tmp_path: Path, start_s: float, late_ns: int) -> None:
    count = 60
    path = write_log(tmp_path / "a.mcap", {"/camera": images(count, late_ns)})
    frames = list(SelectedFrames(McapImageSource(path), start_s=start_s))
    wanted = [number for number in range(count) if number * STEP_NS >= start_s * 1e9]
    assert [frame.stamp_ns for frame in frames] == [EPOCH_NS + number * STEP_NS for number in wanted]
    assert [frame.index for frame in frames] == wanted
    for frame in frames:
        np.testing.assert_array_equal(frame.image, drawn(frame.index))


def test_seek_where_the_clocks_run_apart(tmp_path: Path) -> None:
    """Played back at a fifth of the speed while recording: the log's clock runs five times as fast as the stamps."""
    times = [number * STEP_NS for number in range(100)]
    for speed in (5, 0.2):
        messages = [Logged(EPOCH_NS + int(speed * time), raw(k, EPOCH_NS + time)) for k, time in enumerate(times)]
        path = write_log(tmp_path / "a.mcap", {"/camera": Channel("sensor_msgs/msg/Image", "cdr", messages)})
        frames = list(SelectedFrames(McapImageSource(path), start_s=6.0))
        assert [frame.stamp_ns - EPOCH_NS for frame in frames] == times[60:]


@pytest.mark.parametrize("name", FORMATS)
def test_video_topic(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    packets = stream(name)
    messages = [
        Logged(
            packet.stamp_ns,
            cdr("CompressedImage", stamp_ns=packet.stamp_ns, format=name, data=np.frombuffer(packet.data, np.uint8)),
        )
        for packet in packets
    ]
    path = write_log(tmp_path / "a.mcap", {"/camera": Channel("sensor_msgs/msg/CompressedImage", "cdr", messages)})
    source = McapImageSource(path)
    whole = list(source)
    assert [(frame.index, frame.stamp_ns) for frame in whole] == [(k, p.stamp_ns) for k, p in enumerate(packets)]
    monkeypatch.setattr("logs.source._MARGIN_NS", 1000)
    start_s = (packets[GROUP + 3].stamp_ns - packets[0].stamp_ns) / 1e9
    late = list(SelectedFrames(McapImageSource(path), start_s=start_s))
    assert [frame.stamp_ns for frame in late] == [packet.stamp_ns for packet in packets[GROUP + 3 :]]
    for ours, theirs in zip(late, whole[GROUP + 3 :], strict=True):
        np.testing.assert_array_equal(ours.image, theirs.image)
    with closing(open_log(path)) as log:
        (row,) = camera_topics(log)
    assert row.size == (256, 192)


def test_camera_from_the_log(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    topics = {"/cam0/image_raw": images(3), "/cam0/camera_info": calibration(), "/chatter": text()}
    frames = list(McapImageSource(write_log(tmp_path / "a.mcap", topics)))
    assert len(frames) == 3
    for frame in frames:
        assert frame.camera is not None
        assert (frame.camera.width, frame.camera.fx, frame.camera.cy) == (8, K[0], K[5])
        assert frame.camera.distortion == "radial-tangential"
    assert not caplog.records

    path = write_log(tmp_path / "b.mcap", {**topics, "/cam0/camera_info": calibration(20, 6)})
    assert all(frame.camera is None for frame in McapImageSource(path))
    (record,) = caplog.records
    assert "the calibration on /cam0/camera_info cannot be used" in record.getMessage()


def test_listing(tmp_path: Path) -> None:
    topics = {
        "/cam/image_raw": images(21),
        "/cam/camera_info": calibration(),
        "/cam/compressed": images(3, kind="CompressedImage"),
        "/broken": Channel("sensor_msgs/msg/Image", "cdr", [Logged(EPOCH_NS, b"x")]),
        "/chatter": text(),
        "/one\x1b[31m": images(1),
    }
    with closing(open_log(write_log(tmp_path / "a.mcap", topics))) as log:
        rows = camera_topics(log)
    table = {row.name: row for row in rows}
    assert [row.name for row in rows][-1] == "/cam/camera_info"
    assert set(table) == set(topics) - {"/chatter"}
    image = table["/cam/image_raw"]
    assert (image.count, image.size, str(image.type)) == (21, (8, 6), "sensor_msgs/msg/Image as cdr")
    assert image.rate_hz == pytest.approx(10)
    assert table["/cam/compressed"].size == (8, 6)
    assert table["/cam/camera_info"].size == (8, 6)
    assert (table["/broken"].size, table["/broken"].rate_hz) == (None, None)
    heading, *lines = as_text(rows).splitlines()
    assert heading.split() == ["topic", "type", "messages", "rate", "size"]
    assert "/cam/image_raw" in "".join(lines)
    assert "\x1b" not in as_text(rows)


def test_damaged_part_is_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_log(tmp_path / "a.mcap", {"/camera": images(COUNT)}, chunk_size=100)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 20] = bytes(20)
    path.write_bytes(data)
    source = open_images(path)
    assert isinstance(source, LogImageSource)
    frames = list(source)
    assert source.frame_count == COUNT
    assert len(frames) + source.skipped == COUNT
    assert 1 <= source.skipped <= 3
    assert any("damaged part of the log" in record.getMessage() for record in caplog.records)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.mcap", "nul\0.mcap", "x" * 5000):
        with pytest.raises(InputError, match="cannot open the log"):
            open_images(path)
    with pytest.raises(InputError, match="is no log"):
        open_images(tmp_path)

"""Whole MCAP logs: contents, order, and how much is read for it."""

from __future__ import annotations

import io
import random
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType

from airline.errors import InputError
from logs.files import mcap_merge, mcap_records
from logs.files.mcap_file import McapFile
from logs.files.types import LogFile, Topic, TopicType
from tests.helpers.mcap_logs import Sent, add, chunked, messages, on_topic, read, start, write, write_chunks

WITHOUT_INDEX: list[dict[str, Any]] = [
    {"repeat_channels": False},
    {"repeat_schemas": False},
    {"index_types": IndexType.NONE},
    {"use_chunking": False},
    {"use_statistics": False, "index_types": IndexType.CHUNK},
]
WITH_INDEX: list[dict[str, Any]] = [
    {"index_types": IndexType.CHUNK},
    {"use_statistics": False},
    {"use_summary_offsets": False},
    {"enable_crcs": False},
    {"enable_data_crcs": True},
]


class CountingFile(io.FileIO):
    """A file that knows how much of it was read."""

    count = 0

    def readinto(self, buffer: Any) -> int:
        length = super().readinto(buffer) or 0
        self.count += length
        return length

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(-1 if size is None else size)
        self.count += len(data)
        return data


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[CountingFile]:
    """The files that are opened for reading from now on."""
    files: list[CountingFile] = []

    def open_binary(path: Path) -> io.BufferedReader:
        files.append(CountingFile(path))
        return io.BufferedReader(files[-1])

    monkeypatch.setattr(mcap_records, "open_binary", open_binary)
    return files


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunk_size", [1, 2000, 1 << 20])
def test_whole_log(
    tmp_path: Path,
    open_log: Callable[[Path], McapFile],
    compression: CompressionType,
    chunk_size: int,
    caplog: pytest.LogCaptureFixture,
) -> None:
    sent = messages(40)
    log: LogFile = open_log(write(tmp_path / "drive.mcap", sent, compression=compression, chunk_size=chunk_size))
    assert log.name == "drive"
    assert log.indexed
    assert log.span_ns == (1000, 1390)
    assert set(log.topics) == {"/camera", "/imu"}
    for topic in log.topics:
        assert read(log, topic) == on_topic(sent, topic)
        assert read(log, topic, reverse=True) == on_topic(sent, topic)[::-1]
        assert log.topics[topic].count == len(on_topic(sent, topic))
    assert log.topics["/camera"].type == TopicType("sensor_msgs/msg/Image", "cdr")
    assert log.topics["/imu"].type == TopicType("", "raw")
    assert {message.type for message in log.messages("/camera")} == {
        TopicType("sensor_msgs/msg/Image", "cdr"),
        TopicType("foxglove.RawImage", "json"),
    }
    assert not log.lost
    assert not caplog.records
    log.close()
    log.close()


@pytest.mark.parametrize("options", WITHOUT_INDEX + WITH_INDEX, ids=str)
def test_parts_of_the_index_are_missing(
    tmp_path: Path, open_log: Callable[[Path], McapFile], options: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    sent = messages(60)
    random.Random(1).shuffle(sent)
    log = open_log(write(tmp_path / "a.mcap", sent, chunk_size=2000, **options))
    for topic in ("/camera", "/imu"):
        assert read(log, topic) == on_topic(sent, topic)
        assert read(log, topic, 1300) == [row for row in on_topic(sent, topic) if row[0] >= 1300]
        assert read(log, topic, 1300, reverse=True) == [row for row in on_topic(sent, topic) if row[0] < 1300][::-1]
    assert log.span_ns == (1000, 1590)
    assert not log.lost
    assert not caplog.records


def test_topics_are_counted_without_statistics(tmp_path: Path, open_log: Callable[[Path], McapFile]) -> None:
    sent = messages(60)
    counts = {topic: len(on_topic(sent, topic)) for topic in ("/camera", "/imu")}
    for options in WITHOUT_INDEX:  # these are read through when they are opened
        log = open_log(write(tmp_path / "a.mcap", sent, chunk_size=2000, **options))
        assert {topic: entry.count for topic, entry in log.topics.items()} == counts
    log = open_log(write(tmp_path / "a.mcap", sent, chunk_size=2000, use_statistics=False))
    assert log.topics["/imu"] == Topic(TopicType("", "raw"), None)


@given(
    times=st.lists(st.lists(st.integers(0, 12), min_size=1, max_size=6), max_size=6),
    start_ns=st.none() | st.integers(-1, 14),
    summary=st.booleans(),
)
@settings(max_examples=200, deadline=None)
def test_order_of_time_across_chunks(
    tmp_path_factory: pytest.TempPathFactory, times: list[list[int]], start_ns: int | None, summary: bool
) -> None:
    path = tmp_path_factory.mktemp("order") / "a.mcap"
    numbers = iter(range(99))
    chunks = [[Sent(1 + log_ns % 2, log_ns, 0, 0, bytes([next(numbers)])) for log_ns in part] for part in times]
    options = {} if summary else {"repeat_channels": False}
    write_chunks(path, chunks, compression=CompressionType.NONE, **options)
    expected = on_topic([message for chunk in chunks for message in chunk], "/camera")
    later = [row for row in expected if start_ns is None or row[0] >= start_ns]
    earlier = [row for row in expected if start_ns is None or row[0] < start_ns]
    with closing(McapFile(path)) as log:
        if not expected:
            assert not log.topics
            assert log.span_ns is None
            return
        assert read(log, "/camera", start_ns) == later
        assert read(log, "/camera", start_ns, reverse=True) == earlier[::-1]


def test_opening_reads_the_summary_and_seeking_one_chunk(
    tmp_path: Path, open_log: Callable[[Path], McapFile], counted: list[CountingFile]
) -> None:
    sent = messages(400, size=3000)
    path = tmp_path / "a.mcap"
    places = write_chunks(path, chunked(sent, 10))
    chunk = max(end - begin for begin, end in places)
    margin = 4 * io.DEFAULT_BUFFER_SIZE
    summary = path.stat().st_size - places[-1][1]
    log = open_log(path)
    (file,) = counted
    assert file.count < summary + margin < path.stat().st_size / 10

    file.count = 0
    first = next(log.messages("/camera", sent[-20].log_ns))
    assert first.log_ns >= sent[-20].log_ns
    assert file.count < 2 * chunk + margin

    file.count = 0
    assert next(log.messages("/camera", sent[-20].log_ns, reverse=True)).log_ns < sent[-20].log_ns
    assert file.count < 2 * chunk + margin

    file.count = 0
    assert len(read(log, "/camera")) == len(on_topic(sent, "/camera"))
    assert file.count < 2 * path.stat().st_size


def test_chunks_without_the_topic_are_not_read(
    tmp_path: Path, open_log: Callable[[Path], McapFile], counted: list[CountingFile]
) -> None:
    chunks = [[Sent(3 if number % 10 else 1, number, 0, 0, random.randbytes(20_000))] for number in range(50)]
    for options in ({}, {"repeat_channels": False}):
        write_chunks(tmp_path / "a.mcap", chunks, **options)
        log = open_log(tmp_path / "a.mcap")
        counted[-1].count = 0
        assert [message.log_ns for message in log.messages("/camera")] == [0, 10, 20, 30, 40]
        assert counted[-1].count < 5 * (20_000 + 5 * io.DEFAULT_BUFFER_SIZE)


def test_reading_again_does_not_scan_again(
    tmp_path: Path, open_log: Callable[[Path], McapFile], counted: list[CountingFile]
) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, chunked(messages(400, size=3000), 10))
    path.write_bytes(path.read_bytes()[: places[30][1]])
    log = open_log(path)
    counted[0].count = 0
    assert next(log.messages("/camera", messages(400)[295].log_ns))
    assert counted[0].count < 3 * (places[1][1] - places[1][0])
    assert log.indexed


@pytest.mark.parametrize("compression", CompressionType)
def test_messages_are_views(tmp_path: Path, open_log: Callable[[Path], McapFile], compression: CompressionType) -> None:
    log = open_log(write(tmp_path / "a.mcap", messages(20), compression=compression))
    views = [message.data for message in log.messages("/camera")]
    assert all(isinstance(view, memoryview) and view.readonly for view in views)
    assert len({id(view.obj) for view in views if isinstance(view, memoryview)}) == 1


def test_too_much_overlap(
    tmp_path: Path,
    open_log: Callable[[Path], McapFile],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    sent = messages(200)
    random.Random(2).shuffle(sent)  # every chunk overlaps every other
    path = tmp_path / "a.mcap"
    write_chunks(path, chunked(sent, 10))
    monkeypatch.setattr(mcap_merge, "HELD_LIMIT", 10_000)
    log = open_log(path)
    rows = read(log, "/camera")
    assert rows != on_topic(sent, "/camera")
    assert sorted(rows) == sorted(on_topic(sent, "/camera"))
    assert sorted(read(log, "/camera", reverse=True)) == sorted(on_topic(sent, "/camera"))
    (record,) = caplog.records
    assert "overlaps in time" in record.message


def test_only_overlapping_chunks_are_held(
    tmp_path: Path, open_log: Callable[[Path], McapFile], monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = messages(200)
    path = tmp_path / "a.mcap"
    write_chunks(path, chunked(sent, 10))
    monkeypatch.setattr(mcap_merge, "HELD_LIMIT", 1)
    assert read(open_log(path), "/camera") == on_topic(sent, "/camera")


def test_channels_and_times_at_their_limits(tmp_path: Path, open_log: Callable[[Path], McapFile]) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = start(file)
        same = writer.register_channel("/camera", "cdr", 1)  # another of the same topic and type
        add(writer, [Sent(same, 2**64 - 1, 2**64 - 1, 2**32 - 1, b""), Sent(1, 0, 0, 0, b"x")])
        writer.finish()
    log = open_log(path)
    assert log.topics["/camera"].count == 2
    assert "/imu" not in log.topics  # no messages
    assert [(m.log_ns, m.publish_ns, bytes(m.data)) for m in log.messages("/camera")] == [
        (0, 0, b"x"),
        (2**64 - 1, 2**64 - 1, b""),
    ]
    assert log.span_ns == (0, 2**64 - 1)


def test_empty_logs(tmp_path: Path, open_log: Callable[[Path], McapFile], caplog: pytest.LogCaptureFixture) -> None:
    for options in ({}, {"use_chunking": False}, {"use_statistics": False}):
        log = open_log(write(tmp_path / "a.mcap", [], **options))
        assert not log.topics
        assert log.span_ns is None
        with pytest.raises(InputError, match="no messages on topic '/camera'"):
            log.messages("/camera")
    assert not caplog.records


def test_files_that_are_no_log(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "missing.mcap", Path("nul\0.mcap"), Path("x" * 5000)):
        with pytest.raises(InputError, match="cannot open the log"):
            McapFile(path)
    for content in (b"", b"\x89MCAP0\r", b"#ROSBAG V2.0\n" + bytes(100)):
        (tmp_path / "a.mcap").write_bytes(content)
        with pytest.raises(InputError, match="is not an MCAP file"):
            McapFile(tmp_path / "a.mcap")

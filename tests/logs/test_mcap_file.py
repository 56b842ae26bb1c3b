"""Whole MCAP logs: contents, order, how much is read for it, and indexes that are missing or lie."""

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
from mcap.records import Channel, ChunkIndex, Footer, McapRecord, MessageIndex, Statistics
from mcap.writer import CompressionType, IndexType

from airline.errors import InputError
from logs.files import MCAP_MAGIC, LogFile, Topic, TopicType, mcap_file
from logs.files.mcap_file import McapFile
from tests.helpers.mcap_logs import Sent, add, chunked, messages, on_topic, read, rewrite, start, write, write_chunks

Open = Callable[[Path], McapFile]
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
SENT = messages(60)
COUNTS = {topic: len(on_topic(SENT, topic)) for topic in ("/camera", "/imu")}


def assert_everything(log: LogFile, sent: list[Sent] = SENT) -> None:
    assert {topic: read(log, topic) for topic in log.topics} == {
        topic: on_topic(sent, topic) for topic in ("/camera", "/imu")
    }
    assert not log.lost


def bytes_read() -> int:
    """By this process so far."""
    try:
        return int(Path("/proc/self/io").read_text().split()[1])
    except FileNotFoundError:
        pytest.skip("what a process has read is in /proc")


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunk_size", [1, 2000, 1 << 20])
def test_whole_log(tmp_path, open_log, compression, chunk_size, caplog):
    log = open_log(write(tmp_path / "drive.mcap", SENT, compression=compression, chunk_size=chunk_size))
    assert log.name == "drive"
    assert log.span_ns == (1000, 1590)
    assert_everything(log)
    assert log.topics == {
        "/camera": Topic(TopicType("sensor_msgs/msg/Image", "cdr"), COUNTS["/camera"]),
        "/imu": Topic(TopicType("", "raw"), COUNTS["/imu"]),
    }
    assert {message.type for message in log.messages("/camera")} == {
        TopicType("sensor_msgs/msg/Image", "cdr"),
        TopicType("foxglove.RawImage", "json"),
    }
    assert not caplog.records
    log.close()
    log.close()


@pytest.mark.parametrize("options", WITHOUT_INDEX + WITH_INDEX, ids=str)
def test_parts_of_the_index_are_missing(tmp_path, open_log, options, caplog):
    sent = SENT.copy()
    random.Random(1).shuffle(sent)
    log = open_log(write(tmp_path / "a.mcap", sent, chunk_size=2000, **options))
    assert_everything(log, sent)
    for topic in ("/camera", "/imu"):
        assert read(log, topic, 1300) == [row for row in on_topic(sent, topic) if row[0] >= 1300]
    assert log.span_ns == (1000, 1590)
    unknown = options == {"use_statistics": False}
    counts = dict.fromkeys(COUNTS) if unknown else COUNTS
    assert {topic: entry.count for topic, entry in log.topics.items()} == counts
    assert not caplog.records


@given(
    times=st.lists(st.lists(st.integers(0, 12), min_size=1, max_size=6), max_size=6),
    start_ns=st.none() | st.integers(-1, 14),
    summary=st.booleans(),
)
@settings(max_examples=200)
def test_order_of_time_across_chunks(tmp_path_factory, times, start_ns, summary):
    path = tmp_path_factory.mktemp("order") / "a.mcap"
    numbers = iter(range(99))
    chunks = [[Sent(1 + log_ns % 2, log_ns, 0, 0, bytes([next(numbers)])) for log_ns in part] for part in times]
    write_chunks(path, chunks, compression=CompressionType.NONE, **({} if summary else {"repeat_channels": False}))
    expected = on_topic([message for chunk in chunks for message in chunk], "/camera")
    with closing(McapFile(path)) as log:
        if not expected:
            assert not log.topics
            assert log.span_ns is None
            return
        later = [row for row in expected if start_ns is None or row[0] >= start_ns]
        assert read(log, "/camera", start_ns) == later


def test_opening_reads_the_summary_and_seeking_one_chunk(tmp_path: Path, open_log: Open) -> None:
    sent = messages(400, size=3000)
    path = tmp_path / "a.mcap"
    places = write_chunks(path, chunked(sent, 10))
    chunk = max(end - begin for begin, end in places)
    margin = 4 * io.DEFAULT_BUFFER_SIZE
    summary = path.stat().st_size - places[-1][1]
    before = bytes_read()
    log = open_log(path)
    assert bytes_read() - before < summary + margin < path.stat().st_size / 10
    before = bytes_read()
    first = next(log.messages("/camera", sent[-20].log_ns))
    assert first.log_ns >= sent[-20].log_ns
    assert bytes_read() - before < 2 * chunk + margin
    before = bytes_read()
    assert len(read(log, "/camera")) == len(on_topic(sent, "/camera"))
    assert bytes_read() - before < 2 * path.stat().st_size

    path.write_bytes(path.read_bytes()[: places[30][1]])  # this is read through, but only once
    log = open_log(path)
    before = bytes_read()
    assert next(log.messages("/camera", sent[295].log_ns))
    assert bytes_read() - before < 3 * chunk + margin


def test_chunks_without_the_topic_are_not_read(tmp_path: Path, open_log: Open) -> None:
    chunks = [[Sent(3 if number % 10 else 1, number, 0, 0, random.randbytes(20_000))] for number in range(50)]
    for options in ({}, {"repeat_channels": False}):
        write_chunks(tmp_path / "a.mcap", chunks, **options)
        log = open_log(tmp_path / "a.mcap")
        before = bytes_read()
        assert [message.log_ns for message in log.messages("/camera")] == [0, 10, 20, 30, 40]
        assert bytes_read() - before < 5 * (20_000 + 5 * io.DEFAULT_BUFFER_SIZE)


def test_only_overlapping_chunks_are_held(tmp_path, open_log, monkeypatch, caplog):
    sent = messages(200)
    path = tmp_path / "a.mcap"
    write_chunks(path, chunked(sent, 10))
    monkeypatch.setattr(mcap_file, "HELD_LIMIT", 1)
    assert read(open_log(path), "/camera") == on_topic(sent, "/camera")
    assert not caplog.records

    random.Random(2).shuffle(sent)  # every chunk overlaps every other
    write_chunks(path, chunked(sent, 10))
    monkeypatch.setattr(mcap_file, "HELD_LIMIT", 10_000)
    rows = read(open_log(path), "/camera")
    assert rows != on_topic(sent, "/camera")
    assert sorted(rows) == sorted(on_topic(sent, "/camera"))
    (record,) = caplog.records
    assert "overlaps in time" in record.message


def test_channels_and_times_at_their_limits(tmp_path: Path, open_log: Open) -> None:
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


def test_empty_logs(tmp_path: Path, open_log: Open, caplog: pytest.LogCaptureFixture) -> None:
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
    for content in (b"", MCAP_MAGIC[:7], b"#ROSBAG V2.0\n" + bytes(100)):
        (tmp_path / "a.mcap").write_bytes(content)
        with pytest.raises(InputError, match="is not an MCAP file"):
            McapFile(tmp_path / "a.mcap")


def change(kind: type[McapRecord], **values: Any) -> Callable[[McapRecord], None]:
    """Gives such records other values, or what a function makes of them."""

    def of(record: McapRecord) -> None:
        if isinstance(record, kind):
            for name, value in values.items():
                setattr(record, name, value(record) if callable(value) else value)

    return of


LIES = {
    "other channels": change(ChunkIndex, message_index_offsets=lambda r: dict.fromkeys(r.message_index_offsets, 3)),
    "other places": change(MessageIndex, records=lambda r: [r.records[0]] * len(r.records)),
    "wrong sizes": change(ChunkIndex, uncompressed_size=2**60),
    "same chunk": change(ChunkIndex, chunk_start_offset=99),
    "fewer messages": change(Statistics, channel_message_counts={1: 1, 2: 1}, message_count=2),
    "fewer chunks": change(Statistics, chunk_count=3),
    "summary of everything": change(Footer, summary_start=8),
    "unknown schema": change(Channel, schema_id=lambda r: r.schema_id and 77),
}


@pytest.mark.parametrize("lie", LIES)
def test_lying_index(tmp_path: Path, open_log: Open, lie: str) -> None:
    path = tmp_path / "a.mcap"
    write_chunks(path, chunked(SENT, 6))
    rewrite(path, LIES[lie])
    log = open_log(path)
    assert_everything(log)
    assert {topic: entry.count for topic, entry in log.topics.items()} == COUNTS

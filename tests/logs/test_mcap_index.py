"""MCAP logs whose index lies: everything is read all the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.records import Channel, ChunkIndex, Footer, McapRecord, MessageIndex, Statistics

from logs.files.mcap_file import McapFile
from tests.helpers.mcap_logs import chunked, messages, on_topic, read, rewrite, write_chunks

SENT = messages(60)
CHUNKS = chunked(SENT, 6)
Open = Callable[[Path], McapFile]


def _shifted(record: McapRecord) -> McapRecord:
    if isinstance(record, ChunkIndex):
        record.chunk_start_offset += 3
        record.chunk_length -= 3
    return record


def _other_times(record: McapRecord) -> McapRecord:
    if isinstance(record, ChunkIndex) and record.message_start_time > 1300:
        record.message_start_time -= 200
    return record


def _other_channels(record: McapRecord) -> McapRecord:
    if isinstance(record, ChunkIndex):
        record.message_index_offsets = dict.fromkeys(record.message_index_offsets, 3)
    return record


def _wrong_places(record: McapRecord) -> McapRecord:
    if isinstance(record, MessageIndex):
        record.records = [(time, place + 2**40 if time % 20 else place + 1) for time, place in record.records]
    return record


def _same_places(record: McapRecord) -> McapRecord:
    if isinstance(record, MessageIndex):
        record.records = [record.records[0]] * len(record.records)
    return record


def _wrong_sizes(record: McapRecord) -> McapRecord:
    if isinstance(record, ChunkIndex):
        record.uncompressed_size = 2**60
    return record


def _fewer_messages(record: McapRecord) -> McapRecord:
    if isinstance(record, Statistics):
        record.channel_message_counts = {1: 1, 2: 1}
        record.message_count = 2
    return record


def _fewer_chunks(record: McapRecord) -> McapRecord:
    if isinstance(record, Statistics):
        record.chunk_count = 3
    return record


def _summary_of_everything(record: McapRecord) -> McapRecord:
    if isinstance(record, Footer):
        record.summary_start = 8
    return record


def _unknown_schema(record: McapRecord) -> McapRecord:
    if isinstance(record, Channel):
        record.schema_id = record.schema_id and 77
    return record


@pytest.mark.parametrize(
    "lie",
    [
        *(_shifted, _other_times, _other_channels, _wrong_places, _same_places, _wrong_sizes),
        *(_fewer_messages, _fewer_chunks, _summary_of_everything, _unknown_schema),
    ],
)
def test_lying_index(tmp_path: Path, open_log: Open, lie: Callable[[McapRecord], McapRecord]) -> None:
    path = tmp_path / "a.mcap"
    write_chunks(path, CHUNKS)
    rewrite(path, lie)
    log = open_log(path)
    assert {topic: read(log, topic) for topic in log.topics} == {
        topic: on_topic(SENT, topic) for topic in ("/camera", "/imu")
    }
    assert {topic: entry.count for topic, entry in log.topics.items()} == {
        topic: len(on_topic(SENT, topic)) for topic in ("/camera", "/imu")
    }
    assert not log.lost


def test_index_that_leaves_messages_out(tmp_path: Path, open_log: Open, caplog: pytest.LogCaptureFixture) -> None:
    def leave_out(record: McapRecord) -> McapRecord:
        if isinstance(record, MessageIndex):
            record.records = record.records[1:]
        return record

    path = tmp_path / "a.mcap"
    write_chunks(path, CHUNKS)
    rewrite(path, leave_out)  # all places behind are wrong now
    log = open_log(path)
    assert {topic: read(log, topic) for topic in log.topics} == {
        topic: on_topic(SENT, topic) for topic in ("/camera", "/imu")
    }


def test_statistics_that_promise_more(tmp_path: Path, open_log: Open, caplog: pytest.LogCaptureFixture) -> None:
    def promise(record: McapRecord) -> McapRecord:
        if isinstance(record, Statistics):
            record.channel_message_counts[3] += 5
            record.message_count += 5
        return record

    path = tmp_path / "a.mcap"
    write_chunks(path, CHUNKS)
    rewrite(path, promise)
    log = open_log(path)
    assert read(log, "/imu") == on_topic(SENT, "/imu")
    assert read(log, "/imu") == on_topic(SENT, "/imu")
    assert log.lost == {"missing messages": 5}
    assert [record.levelname for record in caplog.records] == ["WARNING"]

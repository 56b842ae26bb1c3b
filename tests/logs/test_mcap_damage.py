"""MCAP logs that are cut, damaged or hostile: what is sound is read, the rest is counted."""

from __future__ import annotations

import io
import struct
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.records import DataEnd, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType

from logs.files import MCAP_MAGIC
from logs.files.mcap_file import McapFile
from logs.files.mcap_records import CHUNK_LIMIT
from tests.helpers.mcap_logs import (
    CHANNELS,
    Sent,
    chunk_bytes,
    chunked,
    messages,
    on_topic,
    read,
    record_bytes,
    write,
    write_chunks,
)

SENT = messages(60)
CHUNKS = chunked(SENT, 6)
BEHIND = "everything behind a cut or damaged record"
Open = Callable[[Path], McapFile]


def assert_read(log: McapFile, sent: list[Sent]) -> None:
    for topic in ("/camera", "/imu"):
        assert (read(log, topic) if topic in log.topics else []) == on_topic(sent, topic)


def assert_warned_once(caplog: pytest.LogCaptureFixture) -> None:
    assert [record.message for record in caplog.records] == ["a: the log is cut or damaged; its readable part is used"]
    caplog.clear()


def without(number: int) -> list[Sent]:
    return [message for place, chunk in enumerate(CHUNKS) if place != number for message in chunk]


@pytest.mark.parametrize("compression", CompressionType)
def test_cut(tmp_path: Path, open_log: Open, compression: CompressionType, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, compression=compression)
    data = path.read_bytes()
    (summary_start,) = struct.unpack_from("<Q", data, len(data) - 28)
    for size in (*range(len(data) // 20, len(data), len(data) // 20), places[4][1]):
        path.write_bytes(data[:size])
        whole = [message for (_, end), chunk in zip(places, CHUNKS, strict=True) if end <= size for message in chunk]
        log = open_log(path)
        assert_read(log, whole)
        if "/camera" in log.topics:
            middle = on_topic(whole, "/camera")[len(whole) // 4][0]
            assert read(log, "/camera", middle) == [row for row in on_topic(whole, "/camera") if row[0] >= middle]
        if size < summary_start:
            assert_warned_once(caplog)
        within = [begin for begin, end in places if begin < size < end]
        assert log.lost == {BEHIND: 1} if within else set(log.lost) <= {BEHIND}
    assert not caplog.records


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"compression": CompressionType.NONE}])
def test_cut_anywhere(tmp_path: Path, options: dict[str, bool]) -> None:
    path = write(tmp_path / "a.mcap", SENT[:8], chunk_size=600, **options)
    data = path.read_bytes()
    expected = on_topic(SENT[:8], "/camera")
    counts = []
    for size in range(8, len(data), 7):
        path.write_bytes(data[:size])
        with closing(McapFile(path)) as log:
            found = read(log, "/camera") if "/camera" in log.topics else []
        assert found == expected[: len(found)]
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[-1] == len(expected)


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("compression", CompressionType)
def test_a_damaged_chunk_costs_only_itself(tmp_path, open_log, compression, summary, caplog):
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, compression=compression, repeat_channels=summary)
    data = bytearray(path.read_bytes())
    data[places[5][1] - 100] ^= 4
    path.write_bytes(data)
    log = open_log(path)
    for _ in range(2):  # the second time nothing is counted again
        assert_read(log, without(5))
        assert log.lost == {"damaged chunk": 1}
    assert_warned_once(caplog)


@pytest.mark.parametrize("field", ["opcode", "length", "little longer", "size", "compression", "zeros"])
def test_a_damaged_head_costs_only_its_chunk(tmp_path: Path, open_log: Open, field: str) -> None:
    """The index tells where the next chunk is; where there is none, what is behind is lost."""
    path = tmp_path / "a.mcap"
    for summary in (True, False):
        begin, end = write_chunks(path, CHUNKS, repeat_channels=summary)[5]
        data = bytearray(path.read_bytes())
        if field == "little longer":
            data[begin + 1] ^= 1
        elif field == "zeros":
            data[begin - 30 : end - 40] = bytes(end - begin - 10)
        else:
            place = begin + {"opcode": 0, "length": 1, "size": 25, "compression": 41}[field]
            data[place : place + 5] = b"\0\xdc\xba\x98\x76"
        path.write_bytes(data)
        log = open_log(path)
        if summary or field in ("size", "compression"):
            assert_read(log, without(5))
        else:
            assert_read(log, SENT[:30])
        assert log.lost


def test_a_chunk_without_crc_whose_records_do_not_fill_it(tmp_path: Path, open_log: Open) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, enable_crcs=False, compression=CompressionType.NONE)
    data = bytearray(path.read_bytes())
    data[data.find(CHUNKS[5][3].data, *places[5]) - 26] = 255  # in the length of a message
    path.write_bytes(data)
    log = open_log(path)
    assert_read(log, without(5))
    assert log.lost == {"damaged chunk": 1}


def bombs() -> dict[str, bytes]:
    """Chunks that claim or become too much."""
    zeros = bytes(64 << 20)
    small = lz4.frame.compress(zeros, store_size=False)
    frame = bytearray(zstandard.compress(bytes(1000)))  # magic, descriptor, 2 bytes of size
    frame[4] = 0xE0  # 8 bytes of size
    unsized = zstandard.ZstdCompressor(write_content_size=False).compress(zeros)
    return {
        "zstd claims 100 GB": chunk_bytes(zstandard.compress(zeros), 100 << 30, "zstd"),
        "lz4 claims 100 GB": chunk_bytes(small, 100 << 30, "lz4"),
        "none claims 100 GB": chunk_bytes(b"abc", 100 << 30, ""),
        "zstd claims the limit": chunk_bytes(b"abc" * 300, CHUNK_LIMIT, "zstd"),
        "lz4 claims the limit": chunk_bytes(small, CHUNK_LIMIT, "lz4"),
        "zstd claims little": chunk_bytes(zstandard.compress(zeros), 1000, "zstd"),
        "zstd without a size claims little": chunk_bytes(unsized, 1000, "zstd"),
        "zstd's frame claims 2^60": chunk_bytes(bytes(frame[:5]) + struct.pack("<Q", 2**60) + frame[7:], 1000, "zstd"),
        "lz4 claims little": chunk_bytes(small, 1000, "lz4"),
        "lz4's frame claims little": chunk_bytes(lz4.frame.compress(zeros), 1000, "lz4"),
        "unknown compression": chunk_bytes(b"abc", 3, "rot13"),
        "name of 4 GiB": struct.pack("<BQQQQII", 6, 40, 1, 9, 3, 0, 2**32 - 1) + bytes(8),
    }


def test_bombs(tmp_path: Path, open_log: Open, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, repeat_channels=False)
    data = path.read_bytes()
    for name, bomb in bombs().items():
        path.write_bytes(data[: places[4][0]] + bomb + data[places[4][0] :])
        tracemalloc.start()
        log = open_log(path)
        assert_read(log, SENT)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 8 << 20, name
        assert sum(log.lost.values()) == 1, name
        assert_warned_once(caplog)


def test_messages_of_channels_without_schema(tmp_path: Path, open_log: Open) -> None:
    """The schema that a channel names is gone, so that nobody knows what its messages are."""
    path = write(tmp_path / "a.mcap", SENT[:12], use_chunking=False)
    records = list(StreamReader(io.BytesIO(path.read_bytes())).records)
    end = next(place for place, record in enumerate(records) if isinstance(record, DataEnd))
    kept = [record for record in records[:end] if not (isinstance(record, Schema) and record.name == CHANNELS[1][2])]
    path.write_bytes(MCAP_MAGIC + b"".join(map(record_bytes, kept)))
    log = open_log(path)
    assert_read(log, [message for message in SENT[:12] if message.channel != 1])
    assert log.lost == {"messages of unknown channels": sum(message.channel == 1 for message in SENT[:12])}

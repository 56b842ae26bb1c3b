"""MCAP logs that are cut, damaged or hostile: everything readable is read, the rest is counted."""

from __future__ import annotations

import io
import random
import struct
import time
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.records import DataEnd, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType

from airline.errors import InputError
from logs.files.mcap_chunks import CHUNK_LIMIT
from logs.files.mcap_file import McapFile
from tests.helpers.mcap_logs import (
    CHANNELS,
    MAGIC,
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
Open = Callable[[Path], McapFile]


def rows(log: McapFile) -> dict[str, list[tuple[int, int, str, bytes]]]:
    return {topic: read(log, topic) for topic in log.topics}


def assert_warned_once(caplog: pytest.LogCaptureFixture) -> None:
    assert [record.message for record in caplog.records] == ["a: the log is cut or damaged; its readable part is used"]


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("percent", range(5, 100, 5))
def test_cut(
    tmp_path: Path, open_log: Open, compression: CompressionType, percent: int, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, compression=compression)
    data = path.read_bytes()
    size = len(data) * percent // 100
    path.write_bytes(data[:size])
    whole = [message for (_, end), chunk in zip(places, CHUNKS, strict=True) if end <= size for message in chunk]
    log = open_log(path)
    for topic in ("/camera", "/imu"):
        expected = on_topic(whole, topic)
        assert (read(log, topic) if topic in log.topics else []) == expected
        if expected:
            middle = expected[len(expected) // 2][0]
            assert read(log, topic, middle) == [row for row in expected if row[0] >= middle]
    (summary_start,) = struct.unpack_from("<Q", data, len(data) - 28)
    if size < summary_start:
        assert_warned_once(caplog)
    else:  # only the index was cut
        assert not caplog.records
    within = [begin for begin, end in places if begin + 9 <= size < end]
    assert log.lost.get("cut off record", 0) >= len(within)


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


def test_unfinished_at_the_end_of_a_record(tmp_path: Path, open_log: Open, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS)
    path.write_bytes(path.read_bytes()[: places[4][1]])
    log = open_log(path)
    assert read(log, "/imu") == on_topic(SENT[:30], "/imu")
    assert not log.lost
    assert_warned_once(caplog)


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("compression", CompressionType)
def test_a_damaged_chunk_costs_only_itself(
    tmp_path: Path, open_log: Open, compression: CompressionType, summary: bool, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, compression=compression, repeat_channels=summary)
    data = bytearray(path.read_bytes())
    data[places[5][1] - 100] ^= 4
    path.write_bytes(data)
    log = open_log(path)
    rest = [message for number, chunk in enumerate(CHUNKS) if number != 5 for message in chunk]
    for _ in range(2):  # the second time nothing is counted again
        assert read(log, "/camera") == on_topic(rest, "/camera")
        in_chunk = len(on_topic(CHUNKS[5], "/camera"))
        assert log.lost == {"damaged chunk": 1, "messages in damaged chunks": in_chunk}
    assert read(log, "/imu", reverse=True) == on_topic(rest, "/imu")[::-1]
    assert log.lost == {"damaged chunk": 1, "messages in damaged chunks": len(CHUNKS[5])}
    assert_warned_once(caplog)


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("field", ["opcode", "length", "little longer", "size", "times", "compression", "zeros"])
def test_a_damaged_head_costs_only_its_chunk(tmp_path: Path, open_log: Open, field: str, summary: bool) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, repeat_channels=summary)
    data = bytearray(path.read_bytes())
    begin, end = places[5]
    place = {"opcode": 0, "length": 1, "little longer": 1, "size": 25, "times": 9, "compression": 41, "zeros": 0}[field]
    if field == "opcode":
        data[begin] = 0
    elif field == "little longer":
        data[begin + 1] ^= 1
    elif field == "zeros":
        data[begin - 30 : end - 40] = bytes(end - begin - 10)
    else:
        data[begin + place : begin + place + 5] = b"\xfe\xdc\xba\x98\x76"
    path.write_bytes(data)
    log = open_log(path)
    bad = 99 if field == "times" else 5  # only the index needs the times, and it is made anew
    rest = [message for number, chunk in enumerate(CHUNKS) if number != bad for message in chunk]
    for topic in ("/camera", "/imu"):
        assert read(log, topic) == on_topic(rest, topic)
    losses = {name: count for name, count in log.lost.items() if "messages" not in name}
    assert sum(losses.values()) == (bad == 5)


def test_damaged_length_of_a_message_outside_chunks(tmp_path: Path, open_log: Open) -> None:
    path = write(tmp_path / "a.mcap", SENT, use_chunking=False)
    data = bytearray(path.read_bytes())
    place = data.find(SENT[30].data) - 31
    for length in (1 << 60, 0, 5000):
        data[place + 1 : place + 9] = struct.pack("<Q", length)
        path.write_bytes(data)
        log = open_log(path)
        found = [row for topic in log.topics for row in read(log, topic)]
        assert sorted(found) == sorted(on_topic(SENT[:30], "/camera") + on_topic(SENT[:30], "/imu"))
        assert log.lost == {"damaged record": 1}


def test_damage_between_chunks(tmp_path: Path, open_log: Open) -> None:
    """Another log's end and beginning in the middle, then a chunk: what looks like a chunk by chance is none."""
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, repeat_channels=False)
    data = path.read_bytes()
    noise = random.Random(3).randbytes(3 << 20)
    fakes = b"".join(b"\x06" + struct.pack("<QQQQII", n, 0, 1, 400, 1, 0) + bytes(n % 90) for n in range(40, 400))
    for junk in (b"\x7f" * 5000, b"\0" * 5000, noise, fakes, data[places[3][0] : places[3][1] - 50]):
        for middle in (places[7][0], places[6][1]):
            path.write_bytes(data[:middle] + junk + data[middle:])
            log = open_log(path)
            assert rows(log) == {topic: on_topic(SENT, topic) for topic in ("/camera", "/imu")}
            assert log.lost


def test_zeros_at_the_end(tmp_path: Path, open_log: Open, caplog: pytest.LogCaptureFixture) -> None:
    """What a loss of power leaves on some file systems."""
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS)
    path.write_bytes(path.read_bytes()[: places[7][0]] + bytes(100_000))
    log = open_log(path)
    assert read(log, "/camera") == on_topic(SENT[:42], "/camera")
    assert log.lost == {"damaged record": 1}
    assert_warned_once(caplog)


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


@pytest.mark.parametrize("name", bombs())
def test_bombs(tmp_path: Path, open_log: Open, name: str, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, repeat_channels=False)
    data = path.read_bytes()
    path.write_bytes(data[: places[4][0]] + bombs()[name] + data[places[4][0] :])
    tracemalloc.start()
    began = time.monotonic()
    log = open_log(path)
    found = rows(log)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert time.monotonic() - began < 5
    assert peak < 8 << 20
    assert found == {topic: on_topic(SENT, topic) for topic in ("/camera", "/imu")}
    assert sum(log.lost.values()) == 1
    assert_warned_once(caplog)


def test_chunk_without_crc_is_used_up_to_its_damage(tmp_path: Path, open_log: Open) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, enable_crcs=False, compression=CompressionType.NONE)
    data = bytearray(path.read_bytes())
    place = data.find(CHUNKS[5][3].data, *places[5]) - 31
    data[place + 5] = 255
    path.write_bytes(data)
    log = open_log(path)
    for topic in ("/camera", "/imu"):
        found = read(log, topic)
        assert [row for row in found if row[0] < CHUNKS[5][3].log_ns] == on_topic(SENT[:33], topic)
        assert [row for row in found if row[0] > CHUNKS[5][-1].log_ns] == on_topic(SENT[36:], topic)
    assert log.lost["damaged chunk"] == 1
    assert log.lost["missing messages"] >= 1


def test_messages_of_unknown_channels(tmp_path: Path, open_log: Open) -> None:
    """The channels are defined in the first chunk, which is damaged, and there is no summary."""
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS)
    data = bytearray(path.read_bytes()[: places[-1][1]])
    data[places[0][1] - 1] ^= 1
    path.write_bytes(data)
    log = open_log(path)
    assert not log.topics
    assert log.lost["messages of unknown channels"] == len(SENT) - len(CHUNKS[0])
    assert log.lost["damaged chunk"] == 1


def test_messages_of_channels_without_schema(tmp_path: Path, open_log: Open) -> None:
    """The schema that a channel names is gone, so that nobody knows what its messages are."""
    path = write(tmp_path / "a.mcap", SENT[:12], use_chunking=False)
    records = list(StreamReader(io.BytesIO(path.read_bytes())).records)
    end = next(place for place, record in enumerate(records) if isinstance(record, DataEnd))
    kept = [record for record in records[:end] if not (isinstance(record, Schema) and record.name == CHANNELS[1][2])]
    path.write_bytes(MAGIC + b"".join(map(record_bytes, kept)))
    log = open_log(path)
    assert log.lost["messages of unknown channels"] == sum(message.channel == 1 for message in SENT[:12])
    assert read(log, "/camera") == [row for row in on_topic(SENT[:12], "/camera") if row[2] != CHANNELS[1][2]]
    assert read(log, "/imu") == on_topic(SENT[:12], "/imu")


@given(
    changes=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.binary(min_size=0, max_size=12)), max_size=4),
    removed=st.tuples(st.floats(0, 1), st.integers(0, 300)),
    compression=st.sampled_from(CompressionType),
    kind=st.sampled_from(["crc", "no crc", "unchunked"]),
    topic=st.sampled_from(["/camera", "/imu"]),
)
@example(changes=[], removed=(0.0, 139), compression=CompressionType.NONE, kind="crc", topic="/camera")
@settings(max_examples=500, deadline=2000, suppress_health_check=[HealthCheck.too_slow])
def test_mutations(
    tmp_path_factory: pytest.TempPathFactory,
    changes: list[tuple[float, bytes]],
    removed: tuple[float, int],
    compression: CompressionType,
    kind: str,
    topic: str,
) -> None:
    path = tmp_path_factory.getbasetemp() / "mutated.mcap"
    options = {"enable_crcs": kind == "crc", "use_chunking": kind != "unchunked", "chunk_size": 700}
    write(path, SENT[:12], compression=compression, **options)
    data = bytearray(path.read_bytes())
    for where, new in changes:
        place = 8 + int(where * (len(data) - 8))
        data[place : place + len(new)] = new
    place = 8 + int(removed[0] * (len(data) - 8))
    del data[place : place + removed[1]]
    path.write_bytes(data)
    with closing(McapFile(path)) as log:
        expected = set(on_topic(SENT[:12], topic))
        if topic in log.topics:
            found = read(log, topic)
            read(log, topic, 1050)
            read(log, topic, reverse=True)
            if kind == "crc":
                assert set(found) <= expected
                assert len(set(found)) == len(found)


@given(content=st.binary(max_size=300))
@settings(max_examples=100, deadline=2000)
def test_random_bytes(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "random.mcap"
    path.write_bytes(content)
    if not content.startswith(MAGIC):
        with pytest.raises(InputError):
            McapFile(path)
    path.write_bytes(MAGIC + content)
    with closing(McapFile(path)) as log:
        rows(log)

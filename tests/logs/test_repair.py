"""Clean copies of damaged logs: whatever mcap's own reader finds in them, strictly."""

from __future__ import annotations

import random
import tracemalloc
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Attachment, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType

from logs.files.mcap_file import McapFile
from logs.repair import main, repair_mcap
from tests.helpers.mcap_logs import (
    CHANNELS,
    Sent,
    add,
    chunked,
    messages,
    on_topic,
    read,
    read_with_mcap,
    start,
    write,
    write_chunks,
)

SENT = messages(60)
CHUNKS = chunked(SENT, 6)
ATTACHMENT = {
    "create_time": 3,
    "log_time": 4,
    "name": "calibration.yaml",
    "media_type": "text/yaml",
    "data": b"k: 1" * 999,
}


def write_all(path: Path, **options: Any) -> Path:
    """A log with everything in it."""
    with path.open("wb") as file:
        writer = start(file, chunk_size=1500, **options)
        add(writer, SENT[:30])
        writer.add_attachment(**ATTACHMENT)
        add(writer, SENT[30:])
        writer.add_metadata("robot", {"name": "r2", "": "ä"})
        writer.finish()
    return path


def others(path: Path) -> tuple[list[Attachment], list[Metadata]]:
    """Attachments and metadata, found by the index."""
    with path.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        return list(reader.iter_attachments()), list(reader.iter_metadata())


def assert_clean(path: Path, sent: list[Sent]) -> None:
    """Every reader of mcap finds these messages, and the summary agrees."""
    by_time = sorted(sent, key=lambda message: message.log_ns)
    assert read_with_mcap(path) == by_time
    with path.open("rb") as file:
        for _ in StreamReader(file, validate_crcs=True).records:
            pass
        file.seek(0)
        reader = NonSeekingReader(file, validate_crcs=True)
        assert len(list(reader.iter_messages())) == len(sent)
        file.seek(0)
        summary = SeekingReader(file, validate_crcs=True).get_summary()
        file.seek(0)
        header = SeekingReader(file).get_header()
    assert summary is not None
    assert summary.statistics is not None
    assert (header.profile, header.library) == ("test", "a test")
    counts = {number: sum(message.channel == number for message in sent) for number in CHANNELS}
    assert summary.statistics.channel_message_counts == {number: count for number, count in counts.items() if count}
    assert summary.statistics.message_count == len(sent)
    assert summary.statistics.chunk_count == len(summary.chunk_indexes)
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (
        by_time[0].log_ns,
        by_time[-1].log_ns,
    )
    for number, (topic, encoding, schema) in CHANNELS.items():
        if counts[number]:
            channel = summary.channels[number]
            assert (channel.topic, channel.message_encoding) == (topic, encoding)
            assert channel.metadata == {"note": topic}
            assert not schema or summary.schemas[channel.schema_id].name == schema
    with closing(McapFile(path)) as log:
        for topic in log.topics:
            assert read(log, topic) == on_topic(sent, topic)
        assert not log.lost


@pytest.mark.parametrize(
    "options",
    [
        *({"compression": compression} for compression in CompressionType),
        *({"use_chunking": False}, {"enable_crcs": False}, {"repeat_channels": False}, {"use_statistics": False}),
    ],
    ids=str,
)
def test_everything_is_kept(tmp_path: Path, options: dict[str, Any]) -> None:
    path = write_all(tmp_path / "a.mcap", **options)
    repaired = repair_mcap(path, tmp_path / "b.mcap")
    assert_clean(tmp_path / "b.mcap", SENT)
    assert others(tmp_path / "b.mcap") == others(path)
    assert (repaired.attachments, repaired.metadata) == (1, 1)
    assert repaired.messages == {topic: len(on_topic(SENT, topic)) for topic in ("/camera", "/imu")}
    assert not repaired.lost


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("percent", range(10, 100, 15))
def test_cut(tmp_path: Path, compression: CompressionType, percent: int) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, compression=compression)
    data = path.read_bytes()
    size = len(data) * percent // 100
    path.write_bytes(data[:size])
    whole = [message for (_, end), chunk in zip(places, CHUNKS, strict=True) if end <= size for message in chunk]
    repair_mcap(path, tmp_path / "b.mcap")
    assert_clean(tmp_path / "b.mcap", whole)


def test_cut_outside_chunks(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SENT, use_chunking=False)
    data = path.read_bytes()
    path.write_bytes(data[: data.find(SENT[40].data) + 10])
    repaired = repair_mcap(path, tmp_path / "b.mcap")
    assert_clean(tmp_path / "b.mcap", SENT[:40])
    assert repaired.lost == {"cut off record": 1}
    assert repaired.chunks == 1


@pytest.mark.parametrize("summary", [True, False])
def test_damage(tmp_path: Path, summary: bool) -> None:
    path = write_all(tmp_path / "a.mcap", repeat_channels=summary)
    data = bytearray(path.read_bytes())
    data[data.find(b"k: 1k: 1") + 50] ^= 1
    with path.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[-2]
    data[chunk.chunk_start_offset + chunk.chunk_length - 20] ^= 1
    path.write_bytes(data)
    repaired = repair_mcap(path, tmp_path / "b.mcap")
    assert repaired.attachments == 0
    lost = repaired.lost["messages in damaged chunks"]
    assert repaired.lost == {"damaged attachment": 1, "damaged chunk": 1, "messages in damaged chunks": lost}
    kept = read_with_mcap(tmp_path / "b.mcap")
    assert len(kept) == len(SENT) - lost
    assert_clean(tmp_path / "b.mcap", kept)
    assert set(kept) <= set(SENT)
    assert others(tmp_path / "b.mcap")[1] == others(path)[1]


def test_definitions_lost_with_the_first_chunk_come_from_the_summary(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS)
    data = bytearray(path.read_bytes())
    data[places[0][1] - 1] ^= 1
    path.write_bytes(data)
    repair_mcap(path, tmp_path / "b.mcap")
    assert_clean(tmp_path / "b.mcap", SENT[6:])


def test_chunk_without_crc_keeps_what_is_before_its_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    places = write_chunks(path, CHUNKS, enable_crcs=False, compression=CompressionType.NONE)
    data = bytearray(path.read_bytes())
    data[data.find(CHUNKS[5][3].data, *places[5]) - 26] = 255
    path.write_bytes(data)
    repaired = repair_mcap(path, tmp_path / "b.mcap")
    assert_clean(tmp_path / "b.mcap", [message for message in SENT if message not in CHUNKS[5][3:]])
    assert repaired.lost == {"damaged chunk": 1}


def test_unknown_channels_and_schemas(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = start(file)
        without_schema = writer.register_channel("/lost", "cdr", 9)
        add(writer, [*SENT[:5], Sent(77, 1, 1, 1, b"?"), *SENT[5:10], Sent(without_schema, 2000, 1, 1, b"x")])
        writer.finish()
    repaired = repair_mcap(path, tmp_path / "b.mcap")
    assert repaired.lost == {"messages of unknown channels": 1}
    assert read_with_mcap(tmp_path / "b.mcap") == [*SENT[:10], Sent(without_schema, 2000, 1, 1, b"x")]


@given(
    changes=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.binary(min_size=0, max_size=9)), max_size=3),
    cut=st.floats(0.1, 1),
    kind=st.sampled_from(["crc", "no crc", "unchunked"]),
)
@settings(max_examples=200, deadline=2000)
def test_copies_of_mutated_logs_are_clean(
    tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[float, bytes]], cut: float, kind: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "mutated.mcap"
    out = path.with_name("copy.mcap")
    out.unlink(missing_ok=True)
    write_all(path, enable_crcs=kind == "crc", use_chunking=kind != "unchunked")
    data = bytearray(path.read_bytes())
    for where, new in changes:
        place = 8 + int(where * (len(data) - 8))
        data[place : place + len(new)] = new
    path.write_bytes(data[: 8 + int(cut * (len(data) - 8))])
    if main([str(path), "--out", str(out)]):
        assert not out.exists()
        return
    kept = read_with_mcap(out)
    others(out)
    assert kept
    if kind == "crc":
        assert set(kept) <= set(SENT)
    with out.open("rb") as file:
        assert len(list(NonSeekingReader(file, validate_crcs=True).iter_messages())) == len(kept)
    with closing(McapFile(out)) as log:
        assert sum(topic.count or 0 for topic in log.topics.values()) == len(kept)
        assert not log.lost
    assert not repair_mcap(out, path).lost


def test_memory_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = random.Random(0).randbytes(100_000)
    write(path, [Sent(1, number, 0, 0, data) for number in range(400)], compression=CompressionType.LZ4)
    with path.open("ab") as file:
        file.truncate(path.stat().st_size - 2000)
    tracemalloc.start()
    repaired = repair_mcap(path, tmp_path / "b.mcap")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert sum(repaired.messages.values()) > 380
    assert peak < 8 << 20 < path.stat().st_size / 4


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_all(tmp_path / "drive.mcap")
    path.write_bytes(path.read_bytes()[:-6000])
    out = tmp_path / "drive.repaired.mcap"
    assert main([str(path)]) == 0
    printed = capsys.readouterr().out
    kept = read_with_mcap(out)
    assert f"{out}: messages: {len(kept)}, chunks: " in printed
    assert "attachments: 1, metadata records: 0" in printed
    assert "  /camera: " in printed
    assert "lost: cut off record: 1" in printed
    assert sorted(tmp_path.iterdir()) == [path, out]

    before = out.read_bytes()
    assert main([str(path)]) == 2
    assert "exists: give another --out file, or replace it with --overwrite" in capsys.readouterr().err
    assert main([str(out), "--out", str(out), "--overwrite"]) == 2
    assert "is the log itself" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert main([str(path), "--overwrite"]) == 0
    assert out.read_bytes() == before
    assert out.stat().st_mode & 0o777 == path.stat().st_mode & 0o777


def test_errors_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_all(tmp_path / "a.mcap")
    (tmp_path / "text.mcap").write_text("hello")
    (tmp_path / "header.mcap").write_bytes(path.read_bytes()[:60])
    for arguments, error in [
        ([tmp_path / "missing.mcap"], "cannot open the log"),
        ([tmp_path], "is no folder of tracks for LIMAP"),
        ([tmp_path / "text.mcap"], "is not an MCAP file"),
        ([tmp_path / "header.mcap"], "has not one readable message"),
        ([path, "--out", tmp_path / "no" / "b.mcap"], "no folder"),
        ([path, "--out", tmp_path, "--overwrite"], "exists"),
        ([path, "--out", tmp_path / ("x" * 300)], "cannot write"),
    ]:
        assert main([str(argument) for argument in arguments]) == 2
        captured = capsys.readouterr()
        assert error in captured.err
        assert captured.err.count("\n") == 1
        assert not captured.out
    assert len(list(tmp_path.iterdir())) == 3
    with pytest.raises(SystemExit) as stop:
        main([])
    assert stop.value.code == 2

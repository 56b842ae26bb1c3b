"""MCAP files for tests: whole ones, and the same with single records changed."""

from __future__ import annotations

import io
import random
import struct
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Footer, McapRecord
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from logs.files import MCAP_MAGIC, LogFile

CHANNELS = {  # topic, encoding, schema by channel id
    1: ("/camera", "cdr", "sensor_msgs/msg/Image"),
    2: ("/camera", "json", "foxglove.RawImage"),
    3: ("/imu", "raw", ""),
}


class Sent(NamedTuple):
    """A message as it was written."""

    channel: int
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


def messages(count: int, size: int = 300, seed: int = 0) -> list[Sent]:
    """Messages on all channels, in order of time; half of each is noise."""
    rng = random.Random(seed)
    sent = []
    for number in range(count):
        data = rng.randbytes(size // 2) + bytes([number % 256]) * (size - size // 2)
        channel = rng.choice((1, 1, 2, 3))
        sent.append(Sent(channel, 1000 + 10 * number, 7000 + number, number, data))
    return sent


def start(file: Any, **options: Any) -> Writer:
    """A writer that knows all channels; the first two topics come with a schema."""
    writer = Writer(file, **options)
    writer.start(profile="test", library="a test")
    for topic, encoding, schema in CHANNELS.values():
        schema_id = writer.register_schema(schema, "ros2msg", b"uint8[] data") if schema else 0
        writer.register_channel(topic, encoding, schema_id, {"note": topic})
    return writer


def add(writer: Writer, sent: Iterable[Sent]) -> None:
    """Write messages."""
    for message in sent:
        writer.add_message(message.channel, message.log_ns, message.data, message.publish_ns, message.sequence)


def write(path: Path, sent: Iterable[Sent], **options: Any) -> Path:
    """A finished log."""
    with path.open("wb") as file:
        writer = start(file, **options)
        add(writer, sent)
        writer.finish()
    return path


def write_chunks(path: Path, chunks: Sequence[Sequence[Sent]], **options: Any) -> list[tuple[int, int]]:
    """A finished log of these chunks; returns where each chunk begins and ends, as the writer has it."""
    places = []
    with path.open("wb") as file:
        writer = start(file, chunk_size=1 << 40, **options)
        for chunk in chunks:
            add(writer, chunk)
            places.append(file.tell())
            writer.flush()
        writer.finish()
    data = path.read_bytes()
    return [(begin, begin + 9 + struct.unpack_from("<Q", data, begin + 1)[0]) for begin in places]


def chunked(sent: Sequence[Sent], size: int) -> list[Sequence[Sent]]:
    """Parts of `size` messages."""
    return [sent[k : k + size] for k in range(0, len(sent), size)]


def rewrite(path: Path, change: Callable[[McapRecord], None]) -> None:
    """Write all records anew, changed; without a CRC of the summary, and with offsets as they were."""
    records = list(StreamReader(io.BytesIO(path.read_bytes()), emit_chunks=True).records)
    for record in records:
        change(record)
        if isinstance(record, Footer):
            record.summary_crc = 0
    path.write_bytes(MCAP_MAGIC + b"".join(map(record_bytes, records)) + MCAP_MAGIC)


def record_bytes(record: McapRecord) -> bytes:
    """A record as it is in a file."""
    record.write(builder := RecordBuilder())
    return builder.end()


def chunk_bytes(stored: bytes, size: int, compression: str) -> bytes:
    """A chunk record with any claim."""
    return record_bytes(Chunk(compression, stored, 9, 1, 0, size))


def on_topic(sent: Iterable[Sent], topic: str) -> list[tuple[int, int, str, bytes]]:
    """What reading a topic must yield: log time, publish time, schema, data; by time, then as written."""
    kept = sorted((one for one in sent if CHANNELS[one.channel][0] == topic), key=lambda one: one.log_ns)
    return [(one.log_ns, one.publish_ns, CHANNELS[one.channel][2], one.data) for one in kept]


def read(log: LogFile, topic: str, start_ns: int | None = None) -> list[tuple[int, int, str, bytes]]:
    """The same of an opened log."""
    found = log.messages(topic, start_ns)
    return [(one.log_ns, one.publish_ns, one.type.schema_name, bytes(one.data)) for one in found]

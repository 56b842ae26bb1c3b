"""What an MCAP file holds, whole or cut short, and which of it is the camera. Format: https://mcap.dev/spec"""

from __future__ import annotations

import os
import struct
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from zstandard import ZstdError

from airline.errors import InputError
from logs.image_messages import decoder_for, is_image_type

# What mcap raises for cut or damaged files; RuntimeError is lz4's.
DAMAGE = (
    McapError,
    struct.error,
    ValueError,
    LookupError,
    RuntimeError,
    OSError,
    MemoryError,
    OverflowError,
    ZstdError,
)

LogMessage = tuple[Schema | None, Channel, Message]


@dataclass(frozen=True)
class TopicType:
    """The type of a topic's messages, such as "sensor_msgs/msg/Image" in "cdr"."""

    schema_name: str
    encoding: str

    def __str__(self) -> str:
        return f"{self.schema_name or 'no schema'} as {self.encoding or 'unknown encoding'}"


@dataclass(frozen=True)
class Contents:
    """Topics of a log that have messages.

    Attributes:
        types: type per topic.
        counts: messages per topic; None for a log without a sound index.
    """

    types: Mapping[str, TopicType]
    counts: Mapping[str, int] | None


def indexed_reader(file: BinaryIO) -> SeekingReader:
    """A reader of a log with a summary; raises DAMAGE."""
    file.seek(0)
    return SeekingReader(file, validate_crcs=True, record_size_limit=_size(file))


def read_contents(file: BinaryIO) -> Contents:
    """List the topics from the file's summary; without a sound one, by reading all that is readable."""
    try:
        summary = indexed_reader(file).get_summary()
    except DAMAGE:
        summary = None
    if summary and summary.statistics and summary.chunk_indexes:
        types: dict[str, TopicType] = {}
        counts: dict[str, int] = {}
        for channel_id, count in summary.statistics.channel_message_counts.items():
            channel = summary.channels.get(channel_id)
            if channel is None or (channel.schema_id and channel.schema_id not in summary.schemas):
                break
            if count:
                types[channel.topic] = _type(summary.schemas.get(channel.schema_id), channel)
                counts[channel.topic] = counts.get(channel.topic, 0) + count
        else:
            return Contents(types, counts)
    return Contents({channel.topic: _type(schema, channel) for schema, channel, _ in read_unindexed(file)}, None)


def read_unindexed(file: BinaryIO) -> Generator[LogMessage, None, bool]:
    """Messages in the order of the file, leaving out damaged chunks, up to where the file ends or makes no sense.

    Returns:
        Whether nothing was damaged.
    """
    file.seek(0)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    intact = True
    records = StreamReader(file, emit_chunks=True, record_size_limit=_size(file)).records
    while True:
        try:
            record = next(records, None)
        except DAMAGE:
            return False
        if record is None:
            return intact
        parts: list[McapRecord] = [record]
        if isinstance(record, Chunk):
            try:
                parts = breakup_chunk(record, validate_crc=True)
            except DAMAGE:
                intact = False
                continue
        for part in parts:
            if isinstance(part, Schema):
                schemas[part.id] = part
            elif isinstance(part, Channel):
                channels[part.id] = part
            elif isinstance(part, Message) and part.channel_id in channels:
                channel = channels[part.channel_id]
                yield schemas.get(channel.schema_id), channel, part


def choose_topic(types: Mapping[str, TopicType], wanted: str | None) -> str:
    """The image topic to read: the wanted one, or the only one.

    Raises:
        InputError: there is none, several and none is wanted, or it is of a type that is not readable.
    """
    images = {topic: kind for topic, kind in types.items() if is_image_type(kind.schema_name)}
    readable = [topic for topic, kind in images.items() if decoder_for(kind.schema_name, kind.encoding)]
    if wanted is not None and wanted not in types:
        hint = f"its image topics are {_listed(images)}" if images else f"it holds {_listed(types)}"
        raise InputError(f"the log has no messages on topic '{wanted}': {hint}")
    if wanted is not None and wanted not in readable:
        reason = "is not readable yet" if wanted in images else "is no image"
        raise InputError(f"the log's topic {_listed({wanted: types[wanted]})} {reason}")
    if wanted is not None:
        return wanted
    if not images:
        raise InputError(f"the log has no image topic; it holds {_listed(types)}")
    if not readable:
        raise InputError(f"the log's images are of a type that is not readable yet: {_listed(images)}")
    if len(readable) > 1:
        raise InputError(f"the log has several image topics, choose one with --topic: {_listed(images)}")
    return readable[0]


def _type(schema: Schema | None, channel: Channel) -> TopicType:
    return TopicType(schema.name if schema else "", channel.message_encoding)


def _listed(types: Mapping[str, TopicType]) -> str:
    names = [f"{topic} ({kind})" for topic, kind in sorted(types.items())]
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    text = ", ".join(names[:5]) + more if names else "no readable messages"
    return "".join(character if character.isprintable() else "?" for character in text)  # names may be damaged


def _size(file: BinaryIO) -> int:
    """Bytes; no record of a sound log is longer."""
    return os.fstat(file.fileno()).st_size

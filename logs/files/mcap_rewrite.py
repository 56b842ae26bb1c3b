"""Writes the sound parts of an MCAP file as a clean one: chunked, indexed, finished. Format: https://mcap.dev/spec

`mcap.writer.Writer` numbers channels and schemas anew; here they keep their ids, and sound chunks their bytes.
"""

from __future__ import annotations

import struct
import sys
import zlib
from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from logs.files.mcap_chunks import HEAD, MESSAGE, DamageError, walk
from logs.files.mcap_index import INDEX_HEAD
from logs.files.mcap_records import MAGIC, Definitions, Record, RecordFile, parse
from logs.files.mcap_scan import Batch

_BLOCK = 1 << 20
_ATTACHMENT_NAMES = 1 << 17  # bytes in which an attachment's name and type must lie
_CHUNK_FIELDS = struct.Struct("<QQQII")


class _Writable(Protocol):
    def write(self, stream: RecordBuilder) -> None: ...


@dataclass
class _Survey:
    """What is in a batch.

    Attributes:
        places: log time and place of every message, one after the other, by channel.
        schemas, channels: defined in it.
        used: channels whose messages come before their definition, if that is here at all.
        sound: the parts that can stay.
        lost: what cannot: how many times, by reason.
    """

    places: dict[int, array[int]] = field(default_factory=dict)
    schemas: set[int] = field(default_factory=set)
    channels: set[int] = field(default_factory=set)
    used: set[int] = field(default_factory=set)
    sound: list[slice] = field(default_factory=list)
    lost: Counter[str] = field(default_factory=Counter)
    start_ns: int = 2**64
    end_ns: int = -1

    def keep(self, position: int, end: int) -> None:
        """Add a record to the sound parts."""
        if self.sound and self.sound[-1].stop == position:
            position = self.sound.pop().start
        self.sound.append(slice(position, end))

    def add_message(self, channel: int, log_ns: int, position: int) -> None:
        """Note where a message is."""
        if channel not in self.places:
            self.places[channel] = array("Q")
            if channel not in self.channels:
                self.used.add(channel)
        self.places[channel].extend((log_ns, position))
        self.start_ns, self.end_ns = min(self.start_ns, log_ns), max(self.end_ns, log_ns)


class Rewriter:
    """A new MCAP file, written from front to back.

    Args:
        file: an empty one, to write into.
        header: its first record.
        definitions: schemas and channels known so far; those of added batches are taken up.
    """

    def __init__(self, file: BinaryIO, header: Header, definitions: Definitions) -> None:
        self.counts: Counter[int] = Counter()  # messages by channel
        self.chunks = self.attachments = self.metadata = 0
        self._file = file
        self._position = 0
        self._definitions = definitions
        self._schemas: set[int] = set()  # written
        self._channels: set[int] = set()
        self._span_ns = (2**64, -1)
        self._indexes = {Opcode.CHUNK_INDEX: bytearray(), Opcode.ATTACHMENT_INDEX: bytearray()}
        self._indexes[Opcode.METADATA_INDEX] = bytearray()
        self._write(MAGIC + _bytes(header))

    def add_batch(self, batch: Batch) -> Counter[str]:
        """Add a chunk, or make one of a run; returns what of it could not be used: how many times, by reason."""
        data, chunk = batch.data, batch.chunk
        survey = self._survey(data)
        lost = survey.lost
        if lost:
            data = memoryview(b"".join(data[part] for part in survey.sound))
            survey = self._survey(data)
        if not data:
            return lost
        if chunk is None or lost:
            stored, compression = memoryview(zstandard.compress(data)), "zstd"
        else:
            stored, compression = chunk.stored, chunk.compression
        for channel in sorted(survey.used - self._channels):
            self._define(channel, survey)
        for channel in sorted(survey.channels):
            self._define_schema(self._definitions.channels[channel].schema_id, survey)
        self._schemas |= survey.schemas
        self._channels |= survey.channels
        self._write_chunk(survey, data, stored, compression)
        return lost

    def add_attachment(self, source: RecordFile, record: Record) -> None:
        """Copy an attachment; raises DamageError."""
        index = _check_attachment(source, record)
        index.offset = self._position
        self._indexes[Opcode.ATTACHMENT_INDEX] += _bytes(index)
        for block in _blocks(source, record.offset, record.end):
            self._write(block)
        self.attachments += 1

    def add_metadata(self, source: RecordFile, record: Record) -> None:
        """Copy a metadata record; raises DamageError."""
        body = source.body(record)
        index = MetadataIndex(self._position, record.end - record.offset, parse(Metadata, body).name)
        self._indexes[Opcode.METADATA_INDEX] += _bytes(index)
        self._write(HEAD.pack(Opcode.METADATA, len(body)))
        self._write(body)
        self.metadata += 1

    def finish(self) -> None:
        """Write the end of the file."""
        self._write(_bytes(DataEnd(0)))
        start = self._position
        groups: dict[Opcode, bytes | bytearray] = {
            Opcode.SCHEMA: b"".join(_bytes(self._schema(schema)) for schema in sorted(self._schemas)),
            Opcode.CHANNEL: b"".join(_bytes(self._definitions.channels[channel]) for channel in sorted(self._channels)),
            Opcode.STATISTICS: _bytes(self._statistics()),
            **self._indexes,
        }
        section, offsets = bytearray(), bytearray()
        for opcode, group in groups.items():
            if group:
                offsets += _bytes(SummaryOffset(opcode, start + len(section), len(group)))
                section += group
        offsets_start = start + len(section)
        section += offsets
        footer = _bytes(Footer(start, offsets_start, 0))[:-4]
        self._write(section)
        self._write(footer + struct.pack("<I", zlib.crc32(footer, zlib.crc32(section))) + MAGIC)

    def _survey(self, data: memoryview) -> _Survey:
        survey = _Survey()
        try:
            for opcode, position, end in walk(data):
                if opcode == Opcode.MESSAGE:
                    _, _, channel, _, log_ns, _ = MESSAGE.unpack_from(data, position)
                    if channel not in self._definitions.channels:
                        survey.lost["messages of unknown channels"] += 1
                        continue
                    survey.add_message(channel, log_ns, position)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    defined = self._definitions.add(opcode, data[position + HEAD.size : end])
                    if defined is None:
                        survey.lost["unusable schema or channel"] += 1
                        continue
                    (survey.schemas if isinstance(defined, Schema) else survey.channels).add(defined.id)
                survey.keep(position, end)
        except DamageError as error:
            survey.lost[error.reason] += 1
        return survey

    def _define(self, channel_id: int, survey: _Survey) -> None:
        """Write a channel, and before it its schema."""
        channel = self._definitions.channels[channel_id]
        self._define_schema(channel.schema_id, survey)
        self._write(_bytes(channel))
        self._channels.add(channel_id)

    def _define_schema(self, schema_id: int, survey: _Survey) -> None:
        """Write a schema, where a channel has one, unless it is written or comes with the batch."""
        if schema_id and schema_id not in self._schemas | survey.schemas:
            self._write(_bytes(self._schema(schema_id)))
            self._schemas.add(schema_id)

    def _schema(self, schema_id: int) -> Schema:
        """A schema; where it is lost, the one that says so."""
        lost = Schema(id=schema_id, data=b"", encoding="", name="")
        return self._definitions.schemas.get(schema_id, lost)

    def _write_chunk(self, survey: _Survey, data: memoryview, stored: memoryview, compression: str) -> None:
        start_ns, end_ns = (survey.start_ns, survey.end_ns) if survey.places else (0, 0)
        name = compression.encode()
        fields = _CHUNK_FIELDS.pack(start_ns, end_ns, len(data), zlib.crc32(data), len(name))
        fields += name + struct.pack("<Q", len(stored))
        offset = self._position
        self._write(HEAD.pack(Opcode.CHUNK, len(fields) + len(stored)) + fields)
        self._write(stored)
        indexes_start = self._position
        places = {}
        for channel, pairs in survey.places.items():
            places[channel] = self._position
            size = len(pairs) * pairs.itemsize
            self._write(HEAD.pack(Opcode.MESSAGE_INDEX, INDEX_HEAD.size + size) + INDEX_HEAD.pack(channel, size))
            if sys.byteorder == "big":
                pairs.byteswap()
            self._write(memoryview(pairs).cast("B"))
            self.counts[channel] += len(pairs) // 2
        self._indexes[Opcode.CHUNK_INDEX] += _bytes(
            ChunkIndex(
                chunk_length=indexes_start - offset,
                chunk_start_offset=offset,
                compression=compression,
                compressed_size=len(stored),
                message_end_time=end_ns,
                message_index_length=self._position - indexes_start,
                message_index_offsets=places,
                message_start_time=start_ns,
                uncompressed_size=len(data),
            )
        )
        self.chunks += 1
        self._span_ns = min(self._span_ns[0], survey.start_ns), max(self._span_ns[1], survey.end_ns)

    def _statistics(self) -> Statistics:
        start_ns, end_ns = self._span_ns if self.counts else (0, 0)
        return Statistics(
            attachment_count=self.attachments,
            channel_count=len(self._channels),
            channel_message_counts=dict(self.counts),
            chunk_count=self.chunks,
            message_count=self.counts.total(),
            message_end_time=end_ns,
            message_start_time=start_ns,
            metadata_count=self.metadata,
            schema_count=len(self._schemas),
        )

    def _write(self, data: bytes | bytearray | memoryview) -> None:
        self._file.write(data)
        self._position += len(data)


def _bytes(record: _Writable) -> bytes:
    record.write(builder := RecordBuilder())
    data: bytes = builder.end()
    return data


def _check_attachment(source: RecordFile, record: Record) -> AttachmentIndex:
    """An attachment's index entry, without its place; raises DamageError if its lengths or its CRC are wrong."""
    body = source.read(record.body, min(record.length, _ATTACHMENT_NAMES))
    try:
        log_ns, create_ns, name_length = struct.unpack_from("<QQI", body)
        name = str(body[20 : 20 + name_length], "utf-8")
        (type_length,) = struct.unpack_from("<I", body, 20 + name_length)
        media_type = str(body[24 + name_length : 24 + name_length + type_length], "utf-8")
        (size,) = struct.unpack_from("<Q", body, 24 + name_length + type_length)
    except (struct.error, UnicodeDecodeError) as error:
        raise DamageError("damaged attachment") from error
    if record.length != 36 + name_length + type_length + size:
        raise DamageError("damaged attachment")
    crc = 0
    for block in _blocks(source, record.body, record.end - 4):
        crc = zlib.crc32(block, crc)
    if int.from_bytes(source.read(record.end - 4, 4), "little") not in (0, crc):
        raise DamageError("damaged attachment")
    return AttachmentIndex(0, record.end - record.offset, log_ns, create_ns, size, name, media_type)


def _blocks(source: RecordFile, start: int, end: int) -> Iterator[memoryview]:
    for place in range(start, end, _BLOCK):
        yield source.read(place, min(_BLOCK, end - place))

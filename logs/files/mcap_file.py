"""MCAP logs, whole, unfinished, cut or damaged. Format: https://mcap.dev/spec"""

from __future__ import annotations

import logging
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from heapq import heappop, heappush
from io import BytesIO
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary

from airline.errors import InputError
from logs.files import MCAP_MAGIC
from logs.files.mcap_chunks import CHUNK_LIMIT, UNREADABLE, DamageError, chunk_records
from logs.files.types import LogMessage, Topic, TopicType

log = logging.getLogger(__name__)

HELD_LIMIT = 512 << 20
"""Messages of overlapping chunks of more bytes are not held at once."""

_SUMMARY_LIMIT = 64 << 20
_HEAD = struct.Struct("<BQ")  # opcode of a record, and the number of bytes that follow
_FOOTER = struct.Struct("<BQQQI8s")  # head, start of the summary, of its offsets, CRC; the magic
_FOOTER_CRC = struct.calcsize("<BQQQ")  # where the footer has its CRC
_LEAST_MESSAGE = 22  # bytes
_LOOSE = "no chunk"  # in place of a compression: records outside chunks
_LOOSE_OPCODES = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_LOOSE_SIZE = 1 << 20


class McapFile:
    """An MCAP log.

    Opening reads the summary at the end of the file. Where there is none, or it contradicts itself, the file is read
    through once, up to damage that hides where the next record begins. Damaged chunks are left out: `lost` counts
    them, and one warning is logged.

    Raises:
        InputError: the file cannot be opened, or is no MCAP file.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = Path(path)
        try:
            self._file = self._path.open("rb")
            self._size = os.fstat(self._file.fileno()).st_size
            magic = self._file.read(len(MCAP_MAGIC))
        except (OSError, ValueError) as error:
            raise InputError(f"cannot open the log '{path}': {error}") from error
        if magic != MCAP_MAGIC:
            self.close()
            raise InputError(f"'{path}' is not an MCAP file")
        self._lost: Counter[str] = Counter()
        self._damaged: set[int] = set()  # places whose loss is counted
        self._warned: set[str] = set()
        self._summary = self._read_summary() or self._scan()
        self._topics = _topics(self._summary)

    @property
    def name(self) -> str:
        """File name without its suffix."""
        return self._path.stem

    @property
    def topics(self) -> Mapping[str, Topic]:
        """Topics with messages."""
        return self._topics

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log time of all messages, ns; None if there are none."""
        chunks = [
            chunk for chunk in self._summary.chunk_indexes if chunk.message_index_offsets or chunk.message_end_time
        ]
        if not chunks:
            return None
        return min(chunk.message_start_time for chunk in chunks), max(chunk.message_end_time for chunk in chunks)

    @property
    def lost(self) -> Mapping[str, int]:
        """What could not be read so far: how many times, by reason."""
        return dict(self._lost)

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[LogMessage]:
        """Messages of one topic by log time, those of equal times in the order of the file.

        Args:
            topic: one of `topics`.
            start_ns: leave out messages logged earlier; chunks that hold nothing else are not read.

        Raises:
            InputError: no such topic.
        """
        if topic not in self._topics:
            raise InputError(f"the log '{self._path}' has no messages on topic '{topic}'")
        return self._by_time(topic, start_ns or 0)

    def raw_messages(self) -> Iterator[tuple[Schema | None, Channel, Message]]:
        """All readable messages in the order of the file, as the `mcap` package has them."""
        known = _counts(self._summary)
        for chunk in sorted(self._summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset):
            for record in self._load(chunk):
                if isinstance(record, Message) and record.channel_id in known:
                    channel = self._summary.channels[record.channel_id]
                    yield self._summary.schemas.get(channel.schema_id), channel, record

    def close(self) -> None:
        """Release the file; safe to call twice."""
        self._file.close()

    def _by_time(self, topic: str, start_ns: int) -> Iterator[LogMessage]:
        """Holds the messages of chunks that overlap in time."""
        channels = {number for number in _counts(self._summary) if self._summary.channels[number].topic == topic}
        types = {number: _type(self._summary, number) for number in channels}
        waiting = [
            chunk
            for chunk in self._summary.chunk_indexes
            if chunk.message_end_time >= start_ns
            and not (chunk.message_index_offsets and channels.isdisjoint(chunk.message_index_offsets))
        ]
        waiting.sort(key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset), reverse=True)
        heap: list[tuple[int, int, int, Message]] = []
        held = 0
        while waiting or heap:
            while waiting and (not heap or waiting[-1].message_start_time <= heap[0][0]):
                if held > HELD_LIMIT:
                    self._warn("too much of the log overlaps in time; some messages come late")
                    break
                chunk = waiting.pop()
                for place, record in enumerate(self._load(chunk)):
                    if isinstance(record, Message) and record.channel_id in channels and record.log_time >= start_ns:
                        heappush(heap, (record.log_time, chunk.chunk_start_offset, place, record))
                        held += len(record.data)
            if heap:
                *_, message = heappop(heap)
                held -= len(message.data)
                kind = types[message.channel_id]
                yield LogMessage(topic, kind, message.log_time, message.publish_time, message.data)

    def _load(self, chunk: ChunkIndex) -> list[McapRecord]:
        """The records of a chunk; none if it cannot be read."""
        begin, end = chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length
        try:
            return self._contents(begin, end, chunk.compression == _LOOSE)
        except DamageError as error:
            self._lose(begin, str(error))
            return []

    def _contents(self, begin: int, end: int, loose: bool) -> list[McapRecord]:
        """Schemas, channels and messages of a chunk, or of a run of records outside chunks; raises DamageError."""
        if end - begin > CHUNK_LIMIT:
            raise DamageError("record of impossible size")
        if not loose:
            if self._head(begin) != (Opcode.CHUNK, end):
                raise DamageError("damaged record")
            return chunk_records(self._read(begin + _HEAD.size, end - begin - _HEAD.size))
        data = self._read(begin, end - begin)
        try:
            return breakup_chunk(Chunk("", data, 0, 0, 0, len(data)))
        except UNREADABLE as error:
            raise DamageError("damaged record") from error

    def _head(self, place: int) -> tuple[int, int]:
        """Opcode and end of the record at a place; raises DamageError if there can be none."""
        opcode, length = _HEAD.unpack(self._read(place, _HEAD.size))
        end = place + _HEAD.size + length
        if not opcode or end > self._size or (opcode == Opcode.MESSAGE and length < _LEAST_MESSAGE):
            raise DamageError("damaged record")
        return opcode, end

    def _read(self, place: int, length: int) -> bytes:
        """Bytes of the file; raises DamageError where there are not so many or the disk fails."""
        try:
            self._file.seek(place)
            data = self._file.read(length) if 0 <= length <= self._size - place else b""
        except (OSError, ValueError, OverflowError) as error:
            raise DamageError("unreadable part of the disk") from error
        if len(data) != length:
            raise DamageError("damaged record")
        return data

    def _read_summary(self) -> Summary | None:
        """The summary at the file's end; None where it is missing, damaged, or contradicts itself.

        `mcap.reader` would follow a wrong footer into the data and decompress whatever is there.
        """
        place = self._size - _FOOTER.size
        try:
            footer = self._read(place, _FOOTER.size)
            _, _, start, _, crc, _ = _FOOTER.unpack(footer)
            if not len(MCAP_MAGIC) <= start <= place or place - start > _SUMMARY_LIMIT:
                return None
            section = self._read(start, place - start)
            if crc and zlib.crc32(footer[:_FOOTER_CRC], zlib.crc32(section)) != crc:
                return None
            records = list(StreamReader(BytesIO(section + footer), skip_magic=True, emit_chunks=True).records)
        except (DamageError, *UNREADABLE):
            return None
        summary = Summary()
        for record in records:
            if isinstance(record, (Schema, Channel)):
                _define(summary, record)
            elif isinstance(record, Statistics):
                summary.statistics = record
            elif isinstance(record, ChunkIndex):
                summary.chunk_indexes.append(record)
        return summary if _is_sound(summary) else None

    def _scan(self) -> Summary:
        """A summary from reading the file from front to back; holds one chunk at a time."""
        summary = Summary()
        counts: Counter[int] = Counter()
        place, opcode = len(MCAP_MAGIC), 0
        try:
            while place < self._size:
                opcode, end = self._head(place)
                if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    break
                loose = opcode in _LOOSE_OPCODES
                if loose:
                    end = self._end_of_run(end, place + _LOOSE_SIZE)
                if loose or opcode == Opcode.CHUNK:
                    chunk = ChunkIndex(end - place, place, _LOOSE if loose else "", 0, 0, 0, {}, 0, 0)
                    counts += self._survey(chunk, summary)
                place = end
            else:
                self._warn_of_damage()
        except DamageError:
            self._lose(place, "everything behind a cut or damaged record")
        summary.statistics = Statistics(0, 0, counts, len(summary.chunk_indexes), counts.total(), 0, 0, 0, 0)
        return summary

    def _end_of_run(self, end: int, limit: int) -> int:
        """Where a run of records outside chunks ends, of which the first ends at `end`."""
        try:
            while end < limit:
                opcode, following = self._head(end)
                if opcode not in _LOOSE_OPCODES:
                    break
                end = following
        except DamageError:
            pass  # the scan meets it next
        return end

    def _survey(self, chunk: ChunkIndex, summary: Summary) -> Counter[int]:
        """Take up the definitions of a chunk and, if it has messages, its index; returns messages per channel."""
        times, counts = [], Counter[int]()
        for record in self._load(chunk):
            if isinstance(record, (Schema, Channel)):
                _define(summary, record)
            elif isinstance(record, Message) and _is_defined(summary, record.channel_id):
                counts[record.channel_id] += 1
                times.append(record.log_time)
            elif isinstance(record, Message):
                self._lost["messages of unknown channels"] += 1
        if times:
            chunk.message_start_time, chunk.message_end_time = min(times), max(times)
            chunk.message_index_offsets = dict.fromkeys(counts, 0)
            summary.chunk_indexes.append(chunk)
        return counts

    def _lose(self, place: int, reason: str) -> None:
        """Count what is damaged, once."""
        self._warn_of_damage()
        if place not in self._damaged:
            self._damaged.add(place)
            self._lost[reason] += 1

    def _warn_of_damage(self) -> None:
        self._warn("the log is cut or damaged; its readable part is used")

    def _warn(self, what: str) -> None:
        if what not in self._warned:
            log.warning("%s: %s", self.name, what)
        self._warned.add(what)


def _define(summary: Summary, record: Schema | Channel) -> None:
    """Take up a definition; the first of an id counts, as there must not be another."""
    if isinstance(record, Schema):
        summary.schemas.setdefault(record.id, record)
    else:
        summary.channels.setdefault(record.id, record)


def _is_defined(summary: Summary, channel_id: int) -> bool:
    """Whether a channel is known, and with it the schema that it names."""
    channel = summary.channels.get(channel_id)
    return channel is not None and (not channel.schema_id or channel.schema_id in summary.schemas)


def _is_sound(summary: Summary) -> bool:
    """Whether the parts of a summary agree, so that they tell all channels that have messages, and where."""
    chunks, statistics = summary.chunk_indexes, summary.statistics
    listed = {channel for chunk in chunks for channel in chunk.message_index_offsets}
    complete = all(chunk.message_index_offsets for chunk in chunks)
    counted = set(_counts(summary))
    if statistics is None and not (complete and chunks):
        return False
    if statistics is not None and statistics.chunk_count != len(chunks):
        return False
    if listed != counted if complete else not listed <= counted:
        return False
    distinct = len({chunk.chunk_start_offset for chunk in chunks}) == len(chunks)
    return distinct and all(_is_defined(summary, channel) for channel in counted)


def _counts(summary: Summary) -> Mapping[int, int | None]:
    """Messages of each channel that has any; None where there are no statistics."""
    if summary.statistics is not None:
        return {channel: count for channel, count in summary.statistics.channel_message_counts.items() if count}
    return dict.fromkeys(channel for chunk in summary.chunk_indexes for channel in chunk.message_index_offsets)


def _topics(summary: Summary) -> dict[str, Topic]:
    """Topics with messages, each with the type that most of them have."""
    topics: dict[str, Topic] = {}
    for channel, count in sorted(_counts(summary).items(), key=lambda item: -(item[1] or 0)):
        name = summary.channels[channel].topic
        known = topics.get(name, Topic(_type(summary, channel), 0))
        topics[name] = Topic(known.type, None if count is None else count + (known.count or 0))
    return topics


def _type(summary: Summary, channel_id: int) -> TopicType:
    channel = summary.channels[channel_id]
    schema = summary.schemas.get(channel.schema_id)
    return TopicType(schema.name if schema else "", channel.message_encoding)

"""MCAP logs, whole, unfinished, cut or damaged. Format: https://mcap.dev/spec"""

from __future__ import annotations

import logging
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from heapq import heappop, heappush
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, McapRecord, Message, Schema, Statistics
from mcap.summary import Summary

from airline.errors import InputError
from logs.files import LogFile, LogMessage, Topic, TopicType
from logs.files.mcap_records import DamageError, RecordFile, define

log = logging.getLogger(__name__)

HELD_LIMIT = 512 << 20
"""Messages of overlapping chunks of more bytes are not held at once."""

_LOOSE = "no chunk"  # in place of a compression: a run of records outside chunks
_LOOSE_OPCODES = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_LOOSE_SIZE = 1 << 20
_DAMAGED = "the log is cut or damaged; its readable part is used"


class McapFile(LogFile):
    """An MCAP log.

    Opening reads the summary at the end of the file. Where there is none, or it contradicts itself, the file is read
    through once, up to damage that hides where the next record begins. A damaged chunk costs its messages: `lost`
    counts such chunks, and one warning is logged.

    Raises:
        InputError: the file cannot be opened, or is no MCAP file.
    """

    kind = "MCAP"
    _records = RecordFile

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = Path(path)
        self._file = self._records(self._path)
        self.name = self._path.stem
        self.lost = Counter()
        self._damaged: set[int] = set()  # places whose loss is counted
        self._warned: set[str] = set()
        summary = self._file.summary()
        self._summary = summary if summary is not None and _is_sound(summary) else self._scan()
        self.topics = _topics(self._summary)
        chunks = [
            chunk for chunk in self._summary.chunk_indexes if chunk.message_index_offsets or chunk.message_end_time
        ]
        starts, ends = [c.message_start_time for c in chunks], [c.message_end_time for c in chunks]
        self.span_ns = (min(starts), max(ends)) if chunks else None

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[LogMessage]:
        """As in `LogFile`, those of equal times in the order of the file; raises InputError: no such topic."""
        if topic not in self.topics:
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
        """The records of a chunk or run; none, and its loss is counted, if it cannot be read."""
        read = self._file.run if chunk.compression == _LOOSE else self._file.chunk
        begin = chunk.chunk_start_offset
        try:
            return read(begin, begin + chunk.chunk_length)
        except DamageError as error:
            self._lose(begin, str(error))
            return []

    def _scan(self) -> Summary:
        """A summary from reading the file from front to back; holds one chunk at a time."""
        summary = Summary()
        counts: Counter[int] = Counter()
        place, opcode = self._file.begin, 0
        try:
            while opcode not in (Opcode.DATA_END, Opcode.FOOTER) and place < self._file.size:
                opcode, end = self._file.head(place)
                loose = opcode in _LOOSE_OPCODES
                if loose:
                    end = self._end_of_run(end)
                if loose or opcode == Opcode.CHUNK:
                    chunk = ChunkIndex(end - place, place, _LOOSE if loose else "", 0, 0, 0, {}, 0, 0)
                    counts += self._survey(chunk, summary)
                place = end
        except DamageError:
            self._lose(place, "everything behind a cut or damaged record")
        if opcode not in (Opcode.DATA_END, Opcode.FOOTER):
            self._warn(_DAMAGED)
        summary.statistics = Statistics(0, 0, counts, len(summary.chunk_indexes), counts.total(), 0, 0, 0, 0)
        return summary

    def _end_of_run(self, end: int) -> int:
        """Where a run of records outside chunks ends, of which the first ends at `end`."""
        limit = end + _LOOSE_SIZE
        with suppress(DamageError):  # the scan meets it next
            opcode, following = self._file.head(end)
            while opcode in _LOOSE_OPCODES and following < limit:
                end = following
                opcode, following = self._file.head(end)
        return end

    def _survey(self, chunk: ChunkIndex, summary: Summary) -> Counter[int]:
        """Take up a chunk's definitions and, if it has messages, its index; returns messages per channel."""
        times, counts = [], Counter[int]()
        for record in self._load(chunk):
            if isinstance(record, (Schema, Channel)):
                define(summary, record)
            elif isinstance(record, Message) and _is_defined(summary, record.channel_id):
                counts[record.channel_id] += 1
                times.append(record.log_time)
            elif isinstance(record, Message):
                self.lost["messages of unknown channels"] += 1
        if times:
            chunk.message_start_time, chunk.message_end_time = min(times), max(times)
            chunk.message_index_offsets = dict.fromkeys(counts, 0)
            summary.chunk_indexes.append(chunk)
        return counts

    def _lose(self, place: int, reason: str) -> None:
        self._warn(_DAMAGED)
        if place not in self._damaged:
            self._damaged.add(place)
            self.lost[reason] += 1

    def _warn(self, what: str) -> None:
        if what not in self._warned:
            log.warning("%s: %s", self.name, what)
        self._warned.add(what)


def _is_sound(summary: Summary) -> bool:
    """Whether the parts of a summary agree, so that they tell all channels that have messages, and where."""
    chunks, statistics, counted = summary.chunk_indexes, summary.statistics, _counts(summary).keys()
    listed = {channel for chunk in chunks for channel in chunk.message_index_offsets}
    complete = all(chunk.message_index_offsets for chunk in chunks)
    if statistics is None:
        told = complete and bool(chunks)
    else:
        told = statistics.chunk_count == len(chunks) and (listed == counted if complete else listed <= counted)
    distinct = len({chunk.chunk_start_offset for chunk in chunks}) == len(chunks)
    return told and distinct and all(_is_defined(summary, channel) for channel in counted)


def _is_defined(summary: Summary, channel_id: int) -> bool:
    """Whether a channel is known, and with it the schema that it names."""
    channel = summary.channels.get(channel_id)
    return channel is not None and (not channel.schema_id or channel.schema_id in summary.schemas)


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

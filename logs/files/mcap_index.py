"""Where the messages of an MCAP file are: from its summary, or from reading it through. Format: https://mcap.dev/spec"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from mcap.opcode import Opcode
from mcap.records import Statistics

from logs.files.mcap_chunks import HEAD, MESSAGE, DamageError, walk
from logs.files.mcap_records import MAGIC, Definitions, Record, RecordFile, parse
from logs.files.mcap_scan import Batch, Loss, Part, scan
from logs.files.types import Topic, TopicType

INDEX_HEAD = struct.Struct("<HI")
"""Start of a MessageIndex record: channel, bytes of the entries."""

_SUMMARY_LIMIT = 256 << 20
_FOOTER = struct.Struct("<BQQQI")  # head, start of the summary, of its offsets, CRC
_CHUNK_INDEX = struct.Struct("<QQQQI")  # start, end, offset, length, bytes of the listing
_PLACE = struct.Struct("<HQ")  # channel, offset of its MessageIndex record


@dataclass(frozen=True, slots=True)
class Entry:
    """A chunk, or a run of records outside chunks, in the index.

    Attributes:
        offset, end: its place in the file.
        start_ns, end_ns: least and greatest log time.
        size: of the decompressed records, bytes.
        listing: packed pairs of each of its channels and the place of that channel's MessageIndex record (0 where there
            is none); None where its channels are unknown.
        chunked: whether it is a chunk.
    """

    offset: int
    end: int
    start_ns: int
    end_ns: int
    size: int
    listing: bytes | None
    chunked: bool = True

    def places(self) -> dict[int, int] | None:
        """Place of the MessageIndex record by channel; None where its channels are unknown."""
        return None if self.listing is None else dict(_PLACE.iter_unpack(self.listing))


@dataclass(frozen=True)
class Index:
    """Contents of a file.

    Attributes:
        entries: in the order of the file.
        definitions: schemas and channels.
        counts: messages per channel; None where only reading them all would tell.
        listed: channels that have messages.
        from_summary: whether the file says so itself, and may be wrong.
        finished: whether the file has its end.
        lost: what could not be read on the way: how many times, by reason.
        damaged: places of that.
        missing: messages in damaged chunks per channel.
    """

    entries: Sequence[Entry]
    definitions: Definitions
    counts: Mapping[int, int] | None
    listed: frozenset[int]
    from_summary: bool = True
    finished: bool = True
    lost: Mapping[str, int] = field(default_factory=dict)
    damaged: frozenset[int] = frozenset()
    missing: Mapping[int, int] = field(default_factory=dict)

    def topics(self) -> dict[str, Topic]:
        """Topics with messages, each with the type that most of them have."""
        topics: dict[str, Topic] = {}
        counts = self.counts
        for channel in sorted(self.listed, key=lambda channel: -counts[channel] if counts else 0):
            topic = self.definitions.channels[channel].topic
            if topic not in topics:
                topics[topic] = Topic(self.type(channel), None if counts is None else 0)
            if counts is not None:
                topics[topic] = Topic(topics[topic].type, (topics[topic].count or 0) + counts[channel])
        return topics

    def type(self, channel_id: int) -> TopicType:
        """Type of a channel's messages."""
        channel = self.definitions.channels[channel_id]
        schema = self.definitions.schemas.get(channel.schema_id)
        return TopicType(schema.name if schema else "", channel.message_encoding)

    def channels(self, topic: str) -> frozenset[int]:
        """Channels of a topic."""
        return frozenset(channel for channel in self.listed if self.definitions.channels[channel].topic == topic)


def read_summary(file: RecordFile) -> Index | None:
    """The index that the file has at its end; None where it is missing, incomplete, or contradicts itself.

    `mcap` would decompress whatever a wrong footer takes for the summary.
    """
    try:
        section, start = _summary_section(file)
        definitions = Definitions()
        statistics: Statistics | None = None
        entries: list[Entry] = []
        for opcode, position, end in walk(section):
            body = section[position + HEAD.size : end]
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                if definitions.add(opcode, body) is None:
                    return None
            elif opcode == Opcode.STATISTICS:
                statistics = parse(Statistics, body)
            elif opcode == Opcode.CHUNK_INDEX:
                entries.append(_entry(body))
            elif opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                return None
    except DamageError:
        return None
    entries.sort(key=lambda entry: entry.offset)
    ends = [len(MAGIC), *(entry.end for entry in entries)]
    starts = [*(entry.offset for entry in entries), start]
    if any(begin < end for end, begin in zip(ends, starts, strict=True)):
        return None
    return _sound(definitions, statistics, entries)


def _summary_section(file: RecordFile) -> tuple[memoryview, int]:
    """Records of the summary, and where it starts; raises DamageError."""
    place = file.size - len(MAGIC) - _FOOTER.size
    footer = file.read(place, _FOOTER.size + len(MAGIC))
    opcode, length, start, _, crc = _FOOTER.unpack_from(footer)
    if (opcode, length, bytes(footer[_FOOTER.size :])) != (Opcode.FOOTER, _FOOTER.size - HEAD.size, MAGIC):
        raise DamageError("damaged summary")
    if not len(MAGIC) <= start <= place or place - start > _SUMMARY_LIMIT:
        raise DamageError("damaged summary")
    section = file.read(start, place - start)
    if crc and zlib.crc32(footer[: _FOOTER.size - 4], zlib.crc32(section)) != crc:
        raise DamageError("damaged summary")
    return section, start


def _entry(body: memoryview) -> Entry:
    try:
        start_ns, end_ns, offset, length, listing_length = _CHUNK_INDEX.unpack_from(body)
        listing = bytes(body[_CHUNK_INDEX.size : _CHUNK_INDEX.size + listing_length])
        _, name_length = struct.unpack_from("<QI", body, _CHUNK_INDEX.size + listing_length)
        _, size = struct.unpack_from("<QQ", body, _CHUNK_INDEX.size + listing_length + 12 + name_length)
    except struct.error as error:
        raise DamageError("damaged summary") from error
    if listing_length % _PLACE.size or start_ns > end_ns:
        raise DamageError("damaged summary")
    return Entry(offset, offset + length, start_ns, end_ns, size, listing or None)


def _sound(definitions: Definitions, statistics: Statistics | None, entries: list[Entry]) -> Index | None:
    """The index, if its parts agree with each other."""
    listed = {channel for entry in entries for channel in entry.places() or ()}
    complete = all(entry.listing is not None for entry in entries)
    counts = None
    if statistics is not None:
        counts = {channel: count for channel, count in statistics.channel_message_counts.items() if count}
        if statistics.chunk_count != len(entries) or statistics.message_count != sum(counts.values()):
            return None
        if not listed <= counts.keys() or (complete and counts.keys() != listed):
            return None
        listed = set(counts)
    elif not complete or not entries:
        return None
    if not all(definitions.defines(channel) for channel in listed):
        return None
    return Index(entries, definitions, counts, frozenset(listed))


def listed_messages(file: RecordFile, record: Record) -> tuple[int, int]:
    """Channel of a MessageIndex record, and how many messages it lists."""
    try:
        channel, size = INDEX_HEAD.unpack(file.read(record.body, INDEX_HEAD.size))
    except DamageError:  # the disk
        return 0, 0
    return channel, min(size, record.length - INDEX_HEAD.size) // 16


def index_by_scan(file: RecordFile, known_chunks: Sequence[int] = ()) -> Index:
    """The index of what is readable, from reading everything once; holds one chunk at a time."""
    builder = _Builder(file)
    parts = scan(file, known_chunks)
    while True:
        try:
            builder.add(next(parts))
        except StopIteration as end:
            return builder.index(end.value)


class _Builder:
    """Collects an index."""

    def __init__(self, file: RecordFile) -> None:
        self._file = file
        self._definitions = Definitions()
        self._entries: list[Entry] = []
        self._counts: Counter[int] = Counter()
        self._missing: Counter[int] = Counter()
        self._lost: Counter[str] = Counter()
        self._damaged: set[int] = set()
        self._entry: Entry | None = None  # of the last batch; its MessageIndex records follow it
        self._channels: Mapping[int, int] = {}  # messages in it
        self._places: dict[int, int] = {}
        self._after_damage = False

    def add(self, part: Part) -> None:
        """Take up the next part of the file."""
        if isinstance(part, Record):
            if part.opcode == Opcode.MESSAGE_INDEX:
                self._add_places(part)
            return
        self._finish_entry()
        self._after_damage = isinstance(part, Loss) and part.chunk
        if isinstance(part, Loss):
            self._lose(part.offset, part.reason)
        else:
            self._add_batch(part)

    def index(self, finished: bool) -> Index:
        """The index of all that was added."""
        self._finish_entry()
        known = {channel: count for channel, count in self._counts.items() if self._definitions.defines(channel)}
        unknown = self._counts.total() - sum(known.values())
        if unknown:
            self._lost["messages of unknown channels"] += unknown
        return Index(
            entries=self._entries,
            definitions=self._definitions,
            counts=known,
            listed=frozenset(known),
            from_summary=False,
            finished=finished,
            lost=+self._lost,
            damaged=frozenset(self._damaged),
            missing=self._missing,
        )

    def _lose(self, offset: int, reason: str) -> None:
        self._damaged.add(offset)
        self._lost[reason] += 1

    def _add_batch(self, batch: Batch) -> None:
        """Take up definitions, count messages."""
        data = batch.data
        channels: Counter[int] = Counter()
        start_ns, end_ns = 2**64, -1
        try:
            for opcode, position, end in walk(data):
                if opcode == Opcode.MESSAGE:
                    _, _, channel, _, log_ns, _ = MESSAGE.unpack_from(data, position)
                    channels[channel] += 1
                    start_ns, end_ns = min(start_ns, log_ns), max(end_ns, log_ns)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    taken = self._definitions.add(opcode, data[position + HEAD.size : end]) is not None
                    self._lost["unusable schema or channel"] += not taken
        except DamageError as error:
            self._lose(batch.offset, error.reason)
        self._counts.update(channels)
        if channels:
            chunked = batch.chunk is not None
            self._entry = Entry(batch.offset, batch.end, start_ns, end_ns, len(data), None, chunked)
            self._channels = channels

    def _add_places(self, record: Record) -> None:
        """Take up a MessageIndex record."""
        channel, messages = listed_messages(self._file, record)
        if messages == self._channels.get(channel):
            self._places[channel] = record.offset
        if self._after_damage:
            self._missing[channel] += messages

    def _finish_entry(self) -> None:
        if self._entry is not None:
            listing = b"".join(_PLACE.pack(channel, self._places.get(channel, 0)) for channel in self._channels)
            self._entries.append(replace(self._entry, listing=listing))
        self._entry = None
        self._channels = {}
        self._places = {}

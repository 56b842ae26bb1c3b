"""MCAP logs, whole, unfinished, cut or damaged. Format: https://mcap.dev/spec"""

from __future__ import annotations

import logging
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from mcap.opcode import Opcode

from airline.errors import InputError
from logs.files.mcap_chunks import CHUNK_LIMIT, HEAD, MESSAGE, Cut, DamageError, cut, cut_by_index, parse_chunk, unpack
from logs.files.mcap_index import INDEX_HEAD, Entry, Index, index_by_scan, read_summary
from logs.files.mcap_merge import Key, merge
from logs.files.mcap_records import RecordFile
from logs.files.types import LogMessage, Topic

log = logging.getLogger(__name__)


class _FalseIndexError(Exception):
    """The file's own index does not tell where the chunks are."""


class McapFile:
    """An MCAP log.

    Opening reads the summary at the end of the file. Where there is none, or it contradicts itself, the file is read
    through once, and the index that is found on the way serves from then on. Damaged parts are left out: `lost`
    counts them, and one warning is logged.

    Raises:
        InputError: the file cannot be opened, or is no MCAP file.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = Path(path)
        self._file = RecordFile(self._path)
        self._lost: Counter[str] = Counter()
        self._damaged: set[int] = set()  # places whose loss is counted,
        self._topics_damaged: set[tuple[str, int]] = set()  # and with that the loss of a topic's messages
        self._messages_lost: Counter[str] = Counter()  # by topic
        self._missing: Counter[int] = Counter()  # messages in damaged chunks by channel, not counted yet
        self._warned = self._warned_of_order = False
        index = read_summary(self._file)
        self._index = index if index is not None else self._scan()
        self._topics = self._index.topics()

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
        entries = [entry for entry in self._index.entries if entry.listing or entry.end_ns]
        if not entries:
            return None
        return min(entry.start_ns for entry in entries), max(entry.end_ns for entry in entries)

    @property
    def indexed(self) -> bool:
        """Always: what the file lacks is made up for when it is opened."""
        return True

    @property
    def lost(self) -> Mapping[str, int]:
        """What could not be read so far: how many times, by reason."""
        return dict(self._lost)

    def messages(self, topic: str, start_ns: int | None = None, *, reverse: bool = False) -> Iterator[LogMessage]:
        """Messages of one topic by log time, those of equal times in the order of the file.

        Args:
            topic: one of `topics`.
            start_ns: leave out messages logged earlier, without reading them.
            reverse: backwards from the last, or from the last strictly before `start_ns`.

        Raises:
            InputError: no such topic.
        """
        if topic not in self._topics:
            raise InputError(f"the log '{self._path}' has no messages on topic '{topic}'")
        return self._messages(topic, start_ns, reverse)

    def close(self) -> None:
        """Release the file; safe to call twice."""
        self._file.close()

    def _messages(self, topic: str, start_ns: int | None, reverse: bool) -> Iterator[LogMessage]:
        last: Key | None = None
        promised, seen = self._topics[topic].count, 0
        while True:
            try:
                for key, message in self._after(last, topic, start_ns, reverse):
                    last = key
                    seen += 1
                    yield message
                break
            except _FalseIndexError:
                self._index = self._scan([entry.offset for entry in self._index.entries])
                self._topics = {**self._topics, **self._index.topics()}
        if start_ns is None and not reverse:
            self._check_count(topic, promised, seen)

    def _after(
        self, last: Key | None, topic: str, start_ns: int | None, reverse: bool
    ) -> Iterator[tuple[Key, LogMessage]]:
        """Messages behind the one with this key; raises _FalseIndexError."""
        channels = self._index.channels(topic)
        types = {channel: self._index.type(channel) for channel in channels}
        for channel in channels & self._missing.keys():
            self._lose_messages(topic, self._missing.pop(channel))

        def load(entry: Entry) -> Cut | None:
            return self._load(entry, topic, channels)

        entries = self._entries(channels, start_ns, reverse)
        for key, chunk, position in merge(entries, load, start_ns, reverse, self._warn_of_order):
            if last is not None and key <= last:
                continue
            _, length, channel, _, log_ns, publish_ns = MESSAGE.unpack_from(chunk.data, position)
            data = chunk.data[position + MESSAGE.size : position + HEAD.size + length]
            yield key, LogMessage(topic, types[channel], log_ns, publish_ns, data)

    def _entries(self, channels: frozenset[int], start_ns: int | None, reverse: bool) -> Iterator[Entry]:
        """Those that may have such messages."""
        for entry in self._index.entries:
            if start_ns is not None and (entry.start_ns >= start_ns if reverse else entry.end_ns < start_ns):
                continue
            places = entry.places()
            if places is None or not channels.isdisjoint(places):
                yield entry

    def _load(self, entry: Entry, topic: str, channels: frozenset[int]) -> Cut | None:
        """The topic's messages of one chunk; None if it cannot be read. Raises _FalseIndexError."""
        try:
            data = self._contents(entry)
        except DamageError as error:
            if error.misplaced and self._index.from_summary:
                raise _FalseIndexError from error
            unread = self._listed(entry, channels) or {}
            self._lose(entry.offset, error.reason, topic, sum(len(entries) // 16 for entries in unread.values()))
            return None
        listed = self._listed(entry, channels)
        messages = cut_by_index(data, listed) if listed is not None else None
        if messages is None:
            messages = cut(data, channels)
            if not messages.whole:
                self._lose(entry.offset, "damaged chunk")
        return messages

    def _contents(self, entry: Entry) -> memoryview:
        """The records of a chunk, or of a run outside chunks; raises DamageError."""
        if not entry.chunked:
            return self._file.read(entry.offset, entry.end - entry.offset)
        record = self._file.record(entry.offset)
        if record is None or record.end != entry.end or record.opcode != Opcode.CHUNK:
            raise DamageError("damaged record", misplaced=True)
        chunk = parse_chunk(self._file.body(record, 2 * CHUNK_LIMIT))
        as_listed = (chunk.start_ns, chunk.end_ns, chunk.size) == (entry.start_ns, entry.end_ns, entry.size)
        if self._index.from_summary and not as_listed:
            raise DamageError("damaged record", misplaced=True)
        return unpack(chunk)

    def _listed(self, entry: Entry, channels: frozenset[int]) -> dict[int, memoryview] | None:
        """Entries of the MessageIndex records of some channels; None if one of them is missing or damaged."""
        places = entry.places()
        if places is None:
            return None
        listed = {}
        for channel in channels & places.keys():
            record = self._file.record(places[channel]) if places[channel] else None
            if record is None or record.opcode != Opcode.MESSAGE_INDEX:
                return None
            try:
                body = self._file.body(record, INDEX_HEAD.size + entry.size)  # an entry is shorter than its message
            except DamageError:
                return None
            if INDEX_HEAD.unpack_from(body) != (channel, len(body) - INDEX_HEAD.size) or len(body) % 16 != 6:
                return None
            listed[channel] = body[INDEX_HEAD.size :]
        return listed

    def _scan(self, known_chunks: Sequence[int] = ()) -> Index:
        """Read everything through; what was lost before is found again."""
        index = index_by_scan(self._file, known_chunks)
        self._lost = Counter(index.lost)
        self._damaged = set(index.damaged)
        self._topics_damaged = set()
        self._messages_lost = Counter()
        self._missing = Counter(index.missing)
        if index.lost or not index.finished:
            self._warn()
        return index

    def _lose(self, offset: int, reason: str, topic: str = "", messages: int = 0) -> None:
        """Count a damaged chunk, once, and the messages of a topic that are lost with it, once for each topic."""
        self._warn()
        if offset not in self._damaged:
            self._damaged.add(offset)
            self._lost[reason] += 1
        if messages and (topic, offset) not in self._topics_damaged:
            self._topics_damaged.add((topic, offset))
            self._lose_messages(topic, messages)

    def _lose_messages(self, topic: str, count: int) -> None:
        self._messages_lost[topic] += count
        self._lost["messages in damaged chunks"] += count

    def _check_count(self, topic: str, promised: int | None, seen: int) -> None:
        """After all messages of a topic: whether these were as many as the file says."""
        absent = (promised or 0) - seen - self._messages_lost[topic]
        if absent > 0:
            self._warn()
            self._messages_lost[topic] += absent
            self._lost["missing messages"] += absent

    def _warn(self) -> None:
        if not self._warned:
            log.warning("%s: the log is cut or damaged; its readable part is used", self.name)
        self._warned = True

    def _warn_of_order(self) -> None:
        if not self._warned_of_order:
            log.warning("%s: too much of the log overlaps in time; some messages come late", self.name)
        self._warned_of_order = True

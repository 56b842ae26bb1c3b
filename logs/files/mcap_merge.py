"""Messages of overlapping chunks in the order of their times, with bounded memory."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from heapq import heappop, heappush, heapreplace

from logs.files.mcap_chunks import Cut
from logs.files.mcap_index import Entry

HELD_LIMIT = 512 << 20
"""Overlapping chunks of more bytes are not held at once."""

Key = tuple[int, int, int]
"""Log time, place of the chunk, place in it; all negative when reading backwards, so that keys always grow."""


class _Cursor:
    """The wanted messages of a chunk, one after the other."""

    def __init__(self, entry: Entry, messages: Cut | None, start_ns: int | None, reverse: bool) -> None:
        self.messages = messages or Cut(memoryview(b""), array("Q"), array("Q"), False)
        self.size = entry.size
        self._offset = entry.offset
        self._reverse = reverse
        times = self.messages.times
        if reverse:
            end = len(times) if start_ns is None else bisect_left(times, start_ns)
            self._indexes = iter(range(end - 1, -1, -1))
        else:
            self._indexes = iter(range(0 if start_ns is None else bisect_left(times, start_ns), len(times)))

    def next(self) -> tuple[Key, int] | None:
        """Key of the next message and its place in the chunk."""
        index = next(self._indexes, None)
        if index is None:
            return None
        log_ns, position = self.messages.times[index], self.messages.positions[index]
        key = (-log_ns, -self._offset, -position) if self._reverse else (log_ns, self._offset, position)
        return key, position


def merge(
    entries: Iterable[Entry],
    load: Callable[[Entry], Cut | None],
    start_ns: int | None,
    reverse: bool,
    on_overflow: Callable[[], None],
) -> Iterator[tuple[Key, Cut, int]]:
    """Key, chunk and place in it of every message from `start_ns` on; backwards, of those before it.

    Holds only chunks that overlap; where these are too many bytes, calls `on_overflow`, waits with the later chunks,
    and so yields some messages late.
    """

    def first_ns(entry: Entry) -> int:
        return -entry.end_ns if reverse else entry.start_ns

    sign = -1 if reverse else 1
    waiting = sorted(entries, key=lambda entry: (first_ns(entry), sign * entry.offset), reverse=True)
    held = 0
    heap: list[tuple[Key, int, _Cursor]] = []
    while waiting or heap:
        while waiting and (not heap or first_ns(waiting[-1]) <= heap[0][0][0]):
            if heap and held + waiting[-1].size > HELD_LIMIT:
                on_overflow()
                break
            entry = waiting.pop()
            cursor = _Cursor(entry, load(entry), start_ns, reverse)
            head = cursor.next()
            if head is not None:
                heappush(heap, (*head, cursor))
                held += entry.size
        if not heap:
            continue
        key, position, cursor = heap[0]
        yield key, cursor.messages, position
        head = cursor.next()
        if head is None:
            heappop(heap)
            held -= cursor.size
        else:
            heapreplace(heap, (*head, cursor))

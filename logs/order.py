"""Messages that were logged late, put back into the order of their own stamps."""

from __future__ import annotations

from bisect import bisect, insort
from collections import deque
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple

from logs.files import LogMessage
from logs.messages.types import EncodedImage, RawImage, VideoPacket

Picture = RawImage | EncodedImage | VideoPacket

WINDOW = 8
"""A message may come so many messages late."""

_HELD_BYTES = 256 << 20
_REMEMBERED = 32  # stamps of messages that have gone
_HOLE = 1.5  # frame periods between the neighbours of one that is missing
_END_NS = 2**63


class Entry(NamedTuple):
    """A message that was read, and its number among those of its topic."""

    number: int
    message: LogMessage
    record: Picture

    @property
    def stamp_ns(self) -> int:
        return self.record.stamp_ns

    @property
    def delay_ns(self) -> int:
        return self.message.log_ns - self.record.stamp_ns

    @property
    def has_time(self) -> bool:
        return 0 < self.record.stamp_ns < _END_NS

    def repeats(self, other: Entry) -> bool:
        """Whether it holds the same picture of the same time."""
        return self.stamp_ns == other.stamp_ns and self.record.data == other.record.data


class StampOrder:
    """Sorts messages by their own stamps, each at most `WINDOW` places forward; holds twice as many, or 256 MB.

    A stamp that is lower than one before it is that of a late message if the others left a hole where it belongs, and
    the delay between stamps and log falls again behind it. Otherwise a clock stepped back or a stamp is wrong: messages
    keep their order then, and `StampClock` bridges the step.

    Messages that come out are numbered in their new order.

    Args:
        refuse: told of what is left out, and why: late messages whose place has passed, and those that are the same as
            one that is held.

    Attributes:
        late: messages so far that were put forward.
    """

    def __init__(self, refuse: Callable[[Entry, str], None]) -> None:
        self.late = 0
        self._refuse = refuse
        self._held: list[Entry] = []  # in the order of the log
        self._numbers: deque[int] = deque()  # of those
        self._bytes = 0
        self._judged: set[int] = set()  # numbers of the late ones
        self._past: deque[int] = deque(maxlen=_REMEMBERED)  # stamps that have gone, in order, since the last step
        self._last: Entry | None = None
        self._step: int | None = None  # the place in `_held` of the first message behind a step

    def add(self, entry: Entry) -> Iterator[Entry]:
        """Take a message in; yields those whose turn has come."""
        if any(entry.repeats(other) for other in (*self._held, *([self._last] if self._last else ()))):
            self._refuse(entry, "it repeats the frame before it")
            return
        self._held.append(entry)
        self._numbers.append(entry.number)
        self._bytes += len(entry.record.data)
        while len(self._held) > 2 * WINDOW or (self._bytes > _HELD_BYTES and len(self._held) > 1):
            yield from self._next(at_end=False)

    def flush(self) -> Iterator[Entry]:
        """The messages that are left."""
        while self._held:
            yield from self._next(at_end=True)

    def _next(self, at_end: bool) -> Iterator[Entry]:
        """Decide on one message."""
        if self._step is None and (fall := self._fall()) is not None:
            late = self._late_from(fall, at_end)
            self._judged.update(entry.number for entry in late)
            if not late:
                self._step = fall
        if self._step == 0:
            self._past.clear()
            self._step = None
        place = self._earliest()
        entry = self._held.pop(place)
        self._bytes -= len(entry.record.data)
        self._judged.discard(entry.number)
        number = self._numbers.popleft()
        if self._step is not None:
            self._step -= 1
        if entry.has_time:
            if self._past and entry.stamp_ns < self._past[-1]:
                self._refuse(entry, "it was logged too late for its time")
                return
            self._past.append(entry.stamp_ns)
        self.late += place > 0
        self._last = entry
        yield entry._replace(number=number)

    def _earliest(self) -> int:
        """The place of the message whose turn it is."""
        if not self._held[0].has_time:
            return 0
        near = range(min(len(self._held), WINDOW + 1) if self._step is None else min(self._step, WINDOW + 1))
        return min((place for place in near if self._held[place].has_time), key=lambda k: self._held[k].stamp_ns)

    def _fall(self) -> int | None:
        """The first place near the front whose stamp is lower than one before it."""
        highest = self._past[-1] if self._past else 0
        for place, entry in enumerate(self._held[: WINDOW + 1]):
            if entry.has_time and entry.stamp_ns < highest and entry.number not in self._judged:
                return place
            highest = max(highest, entry.stamp_ns if entry.has_time else 0)
        return None

    def _late_from(self, fall: int, at_end: bool) -> list[Entry]:
        """The messages from a place on, up to where stamps go on rising, if they are late."""
        before = [entry for entry in self._held[:fall] if entry.has_time]
        behind = [entry for entry in self._held[fall:] if entry.has_time]
        known = sorted({*self._past, *(entry.stamp_ns for entry in before)})
        end = next((k for k, entry in enumerate(behind) if entry.stamp_ns > known[-1]), len(behind))
        if end > WINDOW or (end == len(behind) and not at_end):
            return []
        steps = [b - a for a, b in pairwise(known)]
        if len(steps) < WINDOW:
            steps = [b - a for a, b in pairwise(sorted({*known, *(entry.stamp_ns for entry in behind)}))]
        period = sorted(steps)[len(steps) // 3]
        if before and end < len(behind) and _stays(before[-1], behind[: end + 1], period):
            return []
        for entry in behind[:end]:
            place = bisect(known, entry.stamp_ns)
            low = known[place - 1] if place else None
            if low == entry.stamp_ns or (low is not None and known[place] - low < _HOLE * period):
                return []
            if low is None and self._past:
                return []
            insort(known, entry.stamp_ns)
        return behind[:end]


def _stays(before: Entry, behind: list[Entry], period: int) -> bool:
    """Whether the delay jumps behind a message and stays: its clock stepped back, by chance into a hole."""
    jumped = behind[0].delay_ns
    return jumped - before.delay_ns > period / 2 and all(abs(entry.delay_ns - jumped) < period / 2 for entry in behind)

"""Messages that were logged late, put back into the order of their own stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from logs.files import LogMessage
from logs.messages.types import EncodedImage, RawImage, VideoPacket

Picture = RawImage | EncodedImage | VideoPacket

WINDOW = 8
"""A message may come so many messages late."""

_HELD_BYTES = 256 << 20
_REMEMBERED = 32  # messages that have gone
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
    def times(self) -> tuple[int, int]:
        return self.stamp_ns, self.delay_ns

    @property
    def has_time(self) -> bool:
        return 0 < self.record.stamp_ns < _END_NS

    def repeats(self, other: Entry) -> bool:
        """Whether it holds the same picture of the same time."""
        return self.stamp_ns == other.stamp_ns and self.record.data == other.record.data


class StampOrder:
    """Sorts messages by their own stamps, each at most `WINDOW` places forward; holds twice as many, or 256 MB.

    Where a stamp is lower than one before it, the delays between stamps and log tell why. If all from there on are
    larger than all before by more than half a frame period, the clock stepped back: messages keep their order there,
    and `StampClock` bridges the step. If at most `WINDOW` just before have smaller delays than all others, their stamps
    lie ahead and are wrong: the log's clock says when they were. Otherwise messages were logged late.

    Messages that come out are numbered in their new order.

    Args:
        refuse: told of what is left out, and why: late messages whose place has passed, and those that are the same as
            one that is held.

    Attributes:
        late: messages so far that were put forward.
        ahead: messages so far whose stamps lay ahead.
    """

    def __init__(self, refuse: Callable[[Entry, str], None]) -> None:
        self.late = self.ahead = 0
        self._refuse = refuse
        self._held: list[Entry] = []  # in the order of the log
        self._numbers: deque[int] = deque()  # of those
        self._bytes = 0
        self._past: deque[tuple[int, int]] = deque(maxlen=_REMEMBERED)  # stamps and delays gone since the last step
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
            yield from self._next()

    def flush(self) -> Iterator[Entry]:
        """The messages that are left."""
        while self._held:
            yield from self._next()

    def _next(self) -> Iterator[Entry]:
        """Decide on one message."""
        if self._step is None:
            self._judge()
        if self._step == 0:
            self._past.clear()
            self._step = None
        place = self._earliest()
        entry = self._held.pop(place)
        self._bytes -= len(entry.record.data)
        number = self._numbers.popleft()
        if self._step is not None:
            self._step -= 1
        if entry.has_time:
            if self._past and entry.stamp_ns < self._past[-1][0]:
                self._refuse(entry, "it was logged too late for its time")
                return
            self._past.append(entry.times)
        self.late += place > 0
        self._last = entry
        yield entry._replace(number=number)

    def _earliest(self) -> int:
        """The place of the message whose turn it is."""
        if not self._held[0].has_time:
            return 0
        near = range(min(len(self._held), WINDOW + 1) if self._step is None else min(self._step, WINDOW + 1))
        return min((place for place in near if self._held[place].has_time), key=lambda k: self._held[k].stamp_ns)

    def _judge(self) -> None:
        """Look for stamps near the front that are lower than one before, and mend those that lie ahead."""
        highest = self._past[-1][0] if self._past else 0
        for place, entry in enumerate(self._held[: WINDOW + 1]):
            if not entry.has_time:
                continue
            if entry.stamp_ns < highest and self._is_step(place):
                self._step = place
                return
            highest = max(highest, entry.stamp_ns)

    def _is_step(self, fall: int) -> bool:
        """Whether the clock stepped back there; if stamps before it lie ahead instead, they are mended."""
        held = [place for place in range(fall) if self._held[place].has_time]
        before = [*self._past, *(self._held[place].times for place in held)]
        behind = [entry.times for entry in self._held[fall:] if entry.has_time]
        if fall == 0 and len(behind) > WINDOW and max(behind)[0] < self._past[-1][0]:
            return True  # else all of them would be left out
        delays = sorted(delay for _, delay in behind)
        stamps = sorted(stamp for stamp, _ in (before if len(before) > WINDOW else before + behind))
        steps = sorted(b - a for a, b in pairwise(stamps))
        period = steps[len(steps) // 8]  # most may span dropped frames
        start = next((k for k in range(len(before), 0, -1) if before[k - 1][1] >= delays[0]), 0)
        rest, low = [delay for _, delay in before[:start]], [delay for _, delay in before[start:]]
        if not low:
            return False
        # Chance is not to look like a step where there are few to compare, nor a clock that runs at another rate.
        gap = max(
            period / 2,
            (median(delays) - delays[0]) / len(low),
            median(low[len(low) // 2 :]) - median(low[: (len(low) + 1) // 2]),
        )
        jump = delays[0] - max(low)
        if jump <= max(gap, behind[0][1] - delays[0]) or (rest and min(rest) - max(low) <= gap):
            return False
        meets = any(abs(a - b) < 0.75 * period for a, _ in before[start:] for b, _ in behind)  # late ones leave a hole
        others = rest + delays
        if len(low) < len(others) and len(low) <= WINDOW:
            if len(low) <= len(held) and jump > (median(others) - min(others) if meets else WINDOW * period):
                self._mend(held[-len(low) :], rest[-1] if rest else delays[0])
            return False
        return len(behind) >= WINDOW or meets or sum(a > max(behind)[0] for a, _ in before) > WINDOW

    def _mend(self, places: list[int], delay_ns: int) -> None:
        for place in places:
            entry = self._held[place]
            record = replace(entry.record, stamp_ns=entry.message.log_ns - delay_ns)
            self._held[place] = entry._replace(record=record)
        self.ahead += len(places)

"""One continuous clock for the frames of a log, whatever the messages' own clocks do."""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Callable
from typing import Literal

from frontend.sources.reading import UndecodableError
from logs.files import LogMessage

log = logging.getLogger(__name__)

TimeSource = Literal["header", "publish", "log"]

_DAY_NS = 86_400 * 10**9
_END_NS = 2**63
_UNITS_NS = 10**9, 10**8, 10**7
_STEPS = 12  # between frames, which tell whether times that come again are the rule
_RATE_HZ = 30.0


def own_stamp(source: TimeSource, header_ns: int, message: LogMessage) -> int:
    """The stamp of a message by itself, ns: the wanted time, or the log's where that is zero or out of range.

    Args:
        source: the wanted time: "header" (the message's own stamp), "publish" or "log".
        header_ns: the message's own stamp, ns.
        message: the message.

    Raises:
        UndecodableError: the log's time is out of range too.
    """
    wanted, fault = _wanted(source, header_ns, message)
    return wanted if fault is None else _in_range(message.log_ns)


class StampClock:
    """Stamps that rise from message to message.

    A wanted time is taken as it is unless it is zero or out of range, runs backwards, comes twice, or jumps by more
    than a day that the log's own clock did not see. Then the frame's stamp is that of the frame before it plus the time
    that has passed between the two on the log's clock, so that one fault does not tear the stream apart; the first such
    frame of each kind is warned of. Where a third of the headers come again, and all are whole seconds, tenths or
    hundredths, the log's clock counts between them throughout. A log's clock that stands still as often is replaced by
    the mean rate.

    Args:
        name: of the log, for warnings.
        source: the wanted time, see `own_stamp`.
        notes: takes a sentence on each kind of fault.
        rate_hz: of the frames, None where it is not known.
    """

    def __init__(
        self,
        name: str,
        source: TimeSource = "header",
        notes: list[str] | None = None,
        rate_hz: Callable[[], float | None] = lambda: None,
    ) -> None:
        self._name, self._source = name, source
        self._notes = [] if notes is None else notes
        self._rate_hz = rate_hz
        self._period_ns = 0  # once it is needed
        self._last: tuple[int, int] | None = None  # stamp and log time of the frame before
        self._step_ns = 0  # between the two frames before
        self._last_wanted: int | None = None
        self._units = list(_UNITS_NS)  # of a clock that does not count finely, those that all headers are multiples of
        self._coarse = self._stands = False  # whether headers, or log times, that come again are the rule
        self._repeated: deque[tuple[bool, bool]] = deque(maxlen=_STEPS)  # whether header and log time came again
        self.faults: Counter[str] = Counter()

    def stamp(self, header_ns: int, message: LogMessage) -> int:
        """The stamp of the next message's frame, ns.

        Raises:
            UndecodableError: no clock says that it is later than the frame before it; a header alone may come twice.
        """
        (wanted, fault), log_ns = _wanted(self._source, header_ns, message), message.log_ns
        if fault is None:
            self._units = [unit for unit in self._units if wanted % unit == 0]
        stamp = wanted
        if self._last is None:
            stamp = stamp if fault is None else _in_range(log_ns)
        else:
            last, last_log_ns = self._last
            counted = last + self._passed(wanted, log_ns - last_log_ns)
            spread = fault is None and self._is_coarse(wanted, counted)
            if fault is None and not spread:
                if stamp == last and self._source != "header":
                    raise UndecodableError("it repeats the time of the frame before it")
                if stamp <= last:
                    fault = "run backwards"
                elif stamp - last > _DAY_NS >= log_ns - last_log_ns:
                    fault = "jump by more than a day"
            if fault is not None or spread:
                if counted <= last:
                    raise UndecodableError("it is not later than the frame before it")
                stamp = _in_range(counted)
                if self._stands:
                    rate = f"at {1e9 / self._period_ns:.4g} Hz"
                    self._note(f"log times come more than once: frames without times are spread evenly, {rate}")
            self._step_ns = stamp - last
        self._last, self._last_wanted = (stamp, log_ns), wanted
        if fault is not None:
            self.faults[fault] += 1
            if self.faults[fault] == 1 and self._source != "log":
                what = f"{self._source} times {fault} at {log_ns * 1e-9:.3f} s of the log's clock, which counts there"
                self._notes.append(f"{what} (--time-source log uses it throughout)")
                log.warning("%s: %s; --time-source log uses it throughout", self._name, what)
        return stamp

    def _passed(self, wanted: int, log_ns: int) -> int:
        """The time since the frame before, ns, from that on the log's clock: a frame period where it stands still."""
        if self._source != "header":
            return log_ns
        repeats, still = wanted == self._last_wanted, log_ns <= 0
        self._repeated.append((repeats, log_ns == 0))
        self._coarse, self._stands = (
            3 * sum(came) >= len(self._repeated) for came in zip(*self._repeated, strict=True)
        )
        if still or self._stands:
            if not self._period_ns:
                self._period_ns = max(round(1e9 / (self._rate_hz() or _RATE_HZ)), 1)
            log_ns = self._period_ns
        if self._step_ns and (repeats or still) and not (self._coarse or self._stands):
            return min(log_ns, max(self._step_ns * 9 // 10, 1))  # the next is not to be overtaken
        return log_ns

    def _is_coarse(self, wanted: int, counted: int) -> bool:
        """Whether a header tells the time less finely than the log's clock, which says `counted`."""
        repeats = self._source == "header" and wanted == self._last_wanted
        if repeats:
            self._note("header times come more than once, with other pictures: the log's clock counts between them")
        return abs(wanted - counted) <= 2 * self._units[0] if self._units and self._coarse else repeats

    def _note(self, what: str) -> None:
        note = f"{what} (--time-source log uses it throughout)"
        if note not in self._notes:
            self._notes.append(note)


def wanted_time(source: TimeSource, header_ns: int, message: LogMessage) -> int:
    """The wanted time of a message as it is, ns; see `own_stamp`."""
    return {"header": header_ns, "publish": message.publish_ns, "log": message.log_ns}[source]


def _wanted(source: TimeSource, header_ns: int, message: LogMessage) -> tuple[int, str | None]:
    """The wanted time of a message, and what is wrong with it by itself."""
    wanted = wanted_time(source, header_ns, message)
    if wanted == 0 and source != "log":
        return wanted, "are zero"
    return wanted, None if 0 <= wanted < _END_NS else "are out of range"


def _in_range(stamp_ns: int) -> int:
    if not 0 <= stamp_ns < _END_NS:
        raise UndecodableError("its time is out of range")
    return stamp_ns

"""One continuous clock for the frames of a log, whatever the messages' own clocks do."""

from __future__ import annotations

import logging
from collections import Counter
from typing import Literal

from frontend.sources.reading import UndecodableError
from logs.files import LogMessage

log = logging.getLogger(__name__)

TimeSource = Literal["header", "publish", "log"]

_DAY_NS = 86_400 * 10**9
_END_NS = 2**63


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

    A wanted time is taken as it is unless it is zero or out of range, runs backwards, or jumps by more than a day that
    the log's own clock did not see. Then the frame's stamp is that of the frame before it plus the time that has passed
    between the two on the log's clock, so that one fault does not tear the stream apart; the first such frame of each
    kind is warned of.

    Args:
        name: of the log, for warnings.
        source: the wanted time, see `own_stamp`.
    """

    def __init__(self, name: str, source: TimeSource = "header") -> None:
        self._name, self._source = name, source
        self._last: tuple[int, int] | None = None  # stamp and log time of the frame before
        self.faults: Counter[str] = Counter()

    def stamp(self, header_ns: int, message: LogMessage) -> int:
        """The stamp of the next message's frame, ns.

        Raises:
            UndecodableError: it repeats the frame before it, or no clock says that it is later.
        """
        (stamp, fault), log_ns = _wanted(self._source, header_ns, message), message.log_ns
        if self._last is None:
            stamp = stamp if fault is None else _in_range(log_ns)
        else:
            last, last_log_ns = self._last
            if fault is None and stamp == last:
                raise UndecodableError("it repeats the time of the frame before it")
            if fault is None and stamp < last:
                fault = "run backwards"
            elif fault is None and stamp - last > _DAY_NS >= log_ns - last_log_ns:
                fault = "jump by more than a day"
            if fault is not None:
                if log_ns <= last_log_ns:
                    raise UndecodableError("it is not later than the frame before it")
                stamp = _in_range(last + log_ns - last_log_ns)
        self._last = stamp, log_ns
        if fault is not None:
            self.faults[fault] += 1
            if self.faults[fault] == 1 and self._source != "log":
                log.warning(
                    "%s: %s times %s at %.3f s of the log's clock, which counts there; "
                    "--time-source log uses it throughout",
                    *(self._name, self._source, fault, log_ns * 1e-9),
                )
        return stamp


def _wanted(source: TimeSource, header_ns: int, message: LogMessage) -> tuple[int, str | None]:
    """The wanted time of a message, and what is wrong with it by itself."""
    wanted = {"header": header_ns, "publish": message.publish_ns, "log": message.log_ns}[source]
    if wanted == 0 and source != "log":
        return wanted, "are zero"
    return wanted, None if 0 <= wanted < _END_NS else "are out of range"


def _in_range(stamp_ns: int) -> int:
    if not 0 <= stamp_ns < _END_NS:
        raise UndecodableError("its time is out of range")
    return stamp_ns

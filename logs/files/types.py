"""What a log file offers, whatever its format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

from logs.messages.types import Bytes


@dataclass(frozen=True)
class TopicType:
    """The type of a topic's messages, such as "sensor_msgs/msg/Image" in "cdr"; empty where the log does not say."""

    schema_name: str
    encoding: str

    def __str__(self) -> str:
        return f"{self.schema_name or 'no schema'} as {self.encoding or 'unknown encoding'}"


@dataclass(frozen=True)
class Topic:
    """A topic that has messages; `count` is None where the log does not say how many."""

    type: TopicType
    count: int | None


@dataclass(frozen=True, slots=True)
class LogMessage:
    """One message: `log_ns` and `publish_ns` are when it was recorded and sent, ns."""

    topic: str
    type: TopicType
    log_ns: int
    publish_ns: int
    data: Bytes


class LogFile(Protocol):
    """An opened log. Reading never stops at damage: what can be read is read, and `lost` counts the rest."""

    @property
    def name(self) -> str:
        """Short name, for file names and warnings."""
        ...

    @property
    def topics(self) -> Mapping[str, Topic]:
        """Topics with messages."""
        ...

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log time of all messages, ns; None if there are none."""
        ...

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[LogMessage]:
        """Messages of one of `topics` by log time; those logged before `start_ns` are left out and not read."""
        ...

    @property
    def lost(self) -> Mapping[str, int]:
        """What could not be read so far: how many times, by reason."""
        ...

    def close(self) -> None:
        """Release the file; safe to call twice."""
        ...

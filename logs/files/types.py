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
    """A topic that has messages.

    Attributes:
        type: of its messages.
        count: messages; None where only reading the whole log would tell.
    """

    type: TopicType
    count: int | None


@dataclass(frozen=True, slots=True)
class LogMessage:
    """One message.

    Attributes:
        topic, type: where it was sent, and what it is.
        log_ns, publish_ns: when it was recorded and sent, ns, as the log has it.
        data: the message, often a view into a buffer: it lives as long as somebody holds it.
    """

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
        """First and last log time of all messages, ns; None where only reading the whole log would tell."""
        ...

    def messages(self, topic: str, start_ns: int | None = None, *, reverse: bool = False) -> Iterator[LogMessage]:
        """Messages of one topic in log-time order where the log has an index, else in the order of the file.

        Args:
            topic: one of `topics`.
            start_ns: leave out messages logged earlier, without reading them where the log has an index.
            reverse: from the last (before `start_ns`, where given: strictly earlier ones) to the first; only where
                `indexed`.
        """
        ...

    @property
    def indexed(self) -> bool:
        """Whether `messages` can begin anywhere without reading what comes before."""
        ...

    @property
    def lost(self) -> Mapping[str, int]:
        """What could not be read so far: how many times, by reason."""
        ...

    def close(self) -> None:
        """Release the file; safe to call twice."""
        ...

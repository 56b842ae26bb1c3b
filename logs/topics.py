"""Topics of a log: which one is meant, and how often it has messages."""

from __future__ import annotations

from collections.abc import Mapping

from airline.errors import InputError
from logs.files.types import LogFile, Topic
from logs.messages.registry import is_image_type, reader_for

_NAMED = 5  # topics in a message


def choose_topic(topics: Mapping[str, Topic], wanted: str | None) -> str:
    """The image topic to read: the wanted one, or the only one.

    Raises:
        InputError: there is none, several and none is wanted, or it is of a type that is not readable.
    """
    images = {name: topic for name, topic in topics.items() if is_image_type(topic.type.schema_name)}
    readable = [name for name, topic in images.items() if reader_for(topic.type.schema_name, topic.type.encoding)]
    if wanted is not None and wanted not in topics:
        hint = f"its image topics are {_listed(images)}" if images else f"it holds {_listed(topics)}"
        raise InputError(f"the log has no messages on topic '{printable(wanted)}': {hint}")
    if wanted is not None:
        if wanted in readable:
            return wanted
        reason = "is not readable" if wanted in images else "is no image"
        raise InputError(f"the log's topic {_listed({wanted: topics[wanted]})} {reason}")
    if not images:
        raise InputError(f"the log has no image topic; it holds {_listed(topics)}")
    if not readable:
        raise InputError(f"the log's images are of a type that is not readable: {_listed(images)}")
    if len(readable) > 1:
        shown = {name: images[name] for name in readable}
        raise InputError(f"the log has several image topics, choose one with --topic: {_listed(shown)}")
    return readable[0]


def mean_rate_hz(file: LogFile, topic: str) -> float | None:
    """Messages per second of the log's clock; None for fewer than two messages, or where their number is unknown.

    Reads the first message, and the log's last second; more of it where the topic has ended before.
    """
    count, span_ns = file.topics[topic].count, file.span_ns
    first = next(file.messages(topic), None)
    if count is None or count < 2 or span_ns is None or first is None:
        return None
    start_ns, window_ns, last_ns = span_ns[1], 10**9, first.log_ns
    while last_ns == first.log_ns < start_ns:
        start_ns = max(span_ns[1] - window_ns, first.log_ns)
        last_ns = max((message.log_ns for message in file.messages(topic, start_ns)), default=last_ns)
        window_ns *= 4
    return (count - 1) * 1e9 / (last_ns - first.log_ns) if last_ns > first.log_ns else None


def printable(text: str) -> str:
    """Names may be damaged, and a terminal obeys control characters."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _listed(topics: Mapping[str, Topic]) -> str:
    names = [
        f"{name} ({topic.type}{'' if topic.count is None else f', {topic.count} messages'})"
        for name, topic in sorted(topics.items())
    ]
    more = f" and {len(names) - _NAMED} more; --list-topics shows all" if len(names) > _NAMED else ""
    return printable(", ".join(names[:_NAMED]) + more) if names else "no readable messages"

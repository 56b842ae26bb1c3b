"""Topics of a log: which one is meant, and what `--list-topics` prints."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

from airline.errors import ConfigError, InputError
from frontend.sources.pairs import partner_of
from frontend.sources.reading import UndecodableError
from logs.files import LogFile, Topic, TopicType
from logs.images.decoder import ImageDecoder
from logs.messages.readers import (
    DepthError,
    check_seen,
    depth_word,
    is_calibration_type,
    is_image_type,
    read_message,
    reader_for,
)
from logs.messages.types import CameraInfo, RawImage

_NAMED = 5  # topics in an error
_TRIED_FOR_DEPTH = 5
_TRIED = 300  # messages until one shows its size; a video may start long before a key frame


def choose_topic(topics: Mapping[str, Topic], wanted: str | None) -> str:
    """The image topic to read: the wanted one, or the only one.

    Raises:
        InputError: there is none, several and none is wanted, or it is of a type that is not readable.
    """
    images = {name: topic for name, topic in topics.items() if is_image_type(topic.type.schema_name)}
    readable = [name for name, topic in images.items() if reader_for(topic.type.schema_name, topic.type.encoding)]
    if wanted is not None:
        if wanted in readable:
            return wanted
        if wanted not in topics:
            hint = f"its image topics are {_listed(images)}" if images else f"it holds {_listed(topics)}"
            raise InputError(f"the log has no messages on topic '{printable(wanted)}': {hint}")
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


def choose_seen(file: LogFile, wanted: str | None) -> tuple[str, bool]:
    """As `choose_topic`, among the topics of a log that are not depth; and whether others were left out for that.

    Raises:
        InputError: as `choose_topic`; there is only depth, or it is wanted.
    """
    images = [name for name, topic in file.topics.items() if is_image_type(topic.type.schema_name)]
    if wanted is not None and wanted not in images:
        return choose_topic(file.topics, wanted), False
    depth = [name for name in (images if wanted is None else [wanted]) if _is_depth(file, name)]
    if depth and len(depth) == len(images if wanted is None else [wanted]):
        others = image_topics(file, but=wanted)
        named = "is depth, which is" if depth_word(depth[0]) else "holds values such as temperature or depth,"
        what = f"choose a topic with pictures by --topic: {others}" if others else "the log has no other images"
        raise InputError(
            f"{_listed({depth[0]: file.topics[depth[0]]})} {named} measured, not seen, and has no lines "
            f"to track: {what}"
        )
    seen = {name: topic for name, topic in file.topics.items() if name not in depth}
    return choose_topic(seen, wanted), bool(depth)


def stereo_topics(file: LogFile, left: str | None) -> tuple[str, str]:
    """The left and the right camera's topics by their names, `left` where it is known; InputError where none tell."""
    seen = [
        name
        for name, topic in file.topics.items()
        if reader_for(topic.type.schema_name, topic.type.encoding)
        and is_image_type(topic.type.schema_name)
        and not _is_depth(file, name)
    ]
    pairs = [(one, two) for one in seen if left in (None, one) and (two := partner_of(one)) in seen and two]
    if len(pairs) == 1:
        return pairs[0]
    found = ", ".join(f"{one} and {two}" for one, two in sorted(pairs)) if pairs else ", ".join(sorted(seen)) or "none"
    what = "has several pairs of image topics" if pairs else "shows no pair by the names of its image topics"
    raise InputError(printable(f"the log {what} ({found}): give --topic LEFT and --right-topic RIGHT"))


def image_topics(file: LogFile, but: str | None) -> str:
    """The other image topics of a log that are not depth, for people."""
    images = {name: topic for name, topic in file.topics.items() if is_image_type(topic.type.schema_name)}
    others = {name: topic for name, topic in images.items() if name != but and not _is_depth(file, name)}
    return _listed(others) if others else ""


def _is_depth(file: LogFile, name: str) -> bool:
    """By the first message that can be read."""
    for message in islice(file.messages(name), _TRIED_FOR_DEPTH):
        try:
            check_seen(read_message(message), name)
        except DepthError:
            return True
        except UndecodableError:
            continue
        return False
    return False


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


@dataclass(frozen=True)
class TopicRow:
    """An image or calibration topic.

    Attributes:
        name, type: as the log has them.
        count: messages; None where the log does not say.
        rate_hz: messages per second of the log's clock; None for fewer than two messages.
        size: width and height, px; None where no message could be read.
    """

    name: str
    type: TopicType
    count: int | None
    rate_hz: float | None
    size: tuple[int, int] | None


def camera_topics(file: LogFile) -> list[TopicRow]:
    """Image topics and then calibration topics of a log, each by name."""
    topics = sorted(file.topics.items())
    return [
        TopicRow(name, topic.type, topic.count, mean_rate_hz(file, name), _size(file, name))
        for wanted in (is_image_type, is_calibration_type)
        for name, topic in topics
        if wanted(topic.type.schema_name)
    ]


def as_text(rows: list[TopicRow]) -> str:
    """The rows as aligned columns with a heading."""
    cells = [("topic", "type", "messages", "rate", "size")]
    for row in rows:
        count = "?" if row.count is None else str(row.count)
        rate = "?" if row.rate_hz is None else f"{row.rate_hz:.1f} Hz"
        size = "?" if row.size is None else f"{row.size[0]}x{row.size[1]}"
        cells.append((printable(row.name), printable(str(row.type)), count, rate, size))
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in cells)
    return "\n".join(line.rstrip() for line in lines)


def _size(file: LogFile, name: str) -> tuple[int, int] | None:
    decoder = ImageDecoder()
    for message in islice(file.messages(name), _TRIED):
        with suppress(UndecodableError, ConfigError):  # the run itself reports them
            record = read_message(message)
            if isinstance(record, (RawImage, CameraInfo)):
                return record.width, record.height
            for image in decoder.decode(record):
                return image.shape[1], image.shape[0]
    return None

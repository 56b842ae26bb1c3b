"""What `--list-topics` prints: the cameras of a log and their calibrations."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

from airline.errors import ConfigError
from logs.files.types import LogFile, TopicType
from logs.images.decoder import ImageDecoder
from logs.messages.registry import is_calibration_type, is_image_type, read_message
from logs.messages.types import CameraInfo, RawImage, UndecodableError
from logs.topics import mean_rate_hz, printable

_TRIED = 300  # messages until one shows its size; a video may start long before a key frame


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
    names = sorted(file.topics)
    images = [name for name in names if is_image_type(file.topics[name].type.schema_name)]
    calibrations = [name for name in names if is_calibration_type(file.topics[name].type.schema_name)]
    return [
        TopicRow(name, file.topics[name].type, file.topics[name].count, mean_rate_hz(file, name), _size(file, name))
        for name in images + calibrations
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
            for _, image in decoder.decode(record):
                return image.shape[1], image.shape[0]
    return None

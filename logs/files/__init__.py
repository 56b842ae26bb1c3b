"""What a log file offers, whatever its format, and which format a file has."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from airline.errors import InputError
from frontend.sources import kinds
from frontend.sources.reading import Bytes

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""What every MCAP file begins with."""


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


class LogFile(ABC):
    """An opened log. Reading never stops at damage: what can be read is read.

    Attributes:
        kind: what it is, for people.
        name: short, for file names and warnings.
        topics: those with messages, by name.
        span_ns: first and last log time of all messages, ns; None if there are none.
        lost: what could not be read so far: how many times, by reason.
    """

    kind: str
    name: str
    topics: Mapping[str, Topic]
    span_ns: tuple[int, int] | None
    lost: Counter[str]

    @abstractmethod
    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[LogMessage]:
        """Messages of one of `topics` by log time; those logged before `start_ns` are left out and not read."""

    @abstractmethod
    def close(self) -> None:
        """Release the file; safe to call twice."""


def open_log(path: str | os.PathLike[str]) -> LogFile:
    """Open a log of any kind; its content decides, not its name. Raises InputError: it cannot be read, or is no log."""
    log = Path(path)
    try:
        start = b""
        if not log.is_dir() and kinds.kind_of(str(log)) not in ("pipe", "device", "camera"):  # which may never answer
            with log.open("rb") as file:
                start = file.read(16)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot open the log '{log}': {error}") from error
    if start.startswith(MCAP_MAGIC):
        from logs.files.mcap_file import McapFile

        return McapFile(log)
    if start.startswith((b"#ROSBAG V", b"SQLite format 3\0")) or _is_bag_folder(log):
        from logs.files.bag_file import BagFile

        return BagFile(log)
    if kinds.kind_of(str(log)) == "packed":
        raise kinds.packed_error(str(log), kinds.start_of(str(log)))
    raise InputError(f"'{log}' is no log: give an MCAP file, a ROS 1 .bag, or the folder or .db3 file of a ROS 2 bag")


def is_log(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a log's: by content, or as a ROS 2 recorder's folder; by its suffix where these say nothing."""
    log = Path(path)
    kind = kinds.kind_of(str(log))
    if kind == "folder":
        return _is_bag_folder(log)
    return kind == "log" or (kind in ("missing", "unknown") and log.suffix.lower() in kinds.LOG_SUFFIXES)


def _is_bag_folder(folder: Path) -> bool:
    """By its metadata; a recording that was killed has none, but files named as ROS 2 names them."""
    try:
        if (folder / "metadata.yaml").is_file():
            with (folder / "metadata.yaml").open("rb") as file:
                return b"rosbag2_bagfile_information" in file.read(4096)
        if not folder.is_dir():
            return False
        stems = [child.stem.rpartition("_") for child in folder.iterdir() if child.suffix in (".db3", ".mcap")]
        return len({bag for bag, *_ in stems}) == 1 and all(number.isdigit() for *_, number in stems)
    except (OSError, ValueError):  # no permission; a name that no file can have
        return False

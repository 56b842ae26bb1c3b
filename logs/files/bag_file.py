"""ROS bags through the rosbags library: ROS 1 files, and ROS 2 folders and files with SQLite or MCAP inside."""

from __future__ import annotations

import logging
import os
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import chain
from pathlib import Path

from natsort import natsorted
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection

from airline.errors import InputError
from logs.files import LogFile, LogMessage, Topic, TopicType
from logs.files.bag_scan import BAG_MAGIC, UnindexedBag

log = logging.getLogger(__name__)

Reader = rosbag1.Reader | rosbag2.Reader


class BagFile(LogFile):
    """A ROS 1 `.bag`, a ROS 2 bag folder, or a `.db3` file out of one.

    The files of a folder without `metadata.yaml`, which a killed recorder leaves behind, are read one after the other.
    A ROS 1 bag whose index is missing or damaged is read from the front, see `UnindexedBag`. A message's publishing
    time is its log time. ROS 1 types are of the encoding "ros1", those of ROS 2 "cdr".

    Raises:
        InputError: it cannot be read, or is no bag; SQLite has not yet put all messages into it.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        path = Path(path)
        _check_whole(path)
        self.lost = Counter()
        self._readers: list[Reader] = []
        self._scanned: UnindexedBag | None = None
        try:
            try:
                self._open(path)
            except Exception as error:
                if not path.is_dir():
                    raise
                self._open(path, alone=True)
                log.warning("%s: %s; the files that are there were read", path, error)
                self.lost["a part of the bag that is not there"] += 1
        except Exception as error:  # damage makes rosbags raise errors of many kinds
            if _is_ros1(path):
                self._take(UnindexedBag(path))
                return
            raise InputError(
                f"cannot read the bag '{path}' ({error}): if its recording was interrupted, reindex it"
            ) from error
        counts: Counter[str] = Counter()
        types: dict[str, TopicType] = {}
        for connection in chain.from_iterable(reader.connections for reader in self._readers):
            counts[connection.topic] += connection.msgcount
            types[connection.topic] = _type(connection)
        self.topics = {name: Topic(types[name], count) for name, count in counts.items() if count}
        self.kind = "ROS 1 bag" if _is_ros1(path) else "ROS 2 bag"
        if len(self._readers) > 1:
            self.kind += f" of {len(self._readers)} files without metadata.yaml, one after the other"
        self.name = path.stem if path.is_file() else path.resolve().name
        spans = [(reader.start_time, reader.end_time - 1) for reader in self._readers if reader.message_count]
        self.span_ns = (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[LogMessage]:
        if self._scanned is not None:
            return self._scanned.messages(topic, start_ns) if topic in self.topics else iter(())
        return chain.from_iterable(self._read(reader, topic, start_ns) for reader in self._readers)

    def close(self) -> None:
        self._opened.close()

    def _open(self, path: Path, alone: bool = False) -> None:
        self._readers.clear()
        with ExitStack() as opened:
            for reader in _readers(path, alone):
                opened.enter_context(reader)
                self._readers.append(reader)
            self._opened = opened.pop_all()

    def _take(self, scanned: UnindexedBag) -> None:
        self._scanned, self._opened = scanned, ExitStack()
        self._opened.callback(scanned.close)
        self.kind, self.name, self.topics = scanned.kind, scanned.name, scanned.topics
        self.span_ns, self.lost = scanned.span_ns, scanned.lost

    def _read(self, reader: Reader, topic: str, start_ns: int | None) -> Iterator[LogMessage]:
        """Messages from start_ns on, or to where the bag is damaged."""
        wanted = [connection for connection in reader.connections if connection.topic == topic]
        if not wanted:  # no connections would mean all of them
            return
        try:
            for connection, log_ns, data in reader.messages(wanted, start=start_ns):
                yield LogMessage(topic, _type(connection), log_ns, log_ns, data)
        except Exception as error:
            self.lost[f"everything behind a damaged place of the bag ({error})"[:200]] += 1


def _type(connection: Connection) -> TopicType:
    return TopicType(connection.msgtype, "ros1" if isinstance(connection.owner, rosbag1.Reader) else "cdr")


def _is_ros1(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(BAG_MAGIC)) == BAG_MAGIC
    except (OSError, ValueError):
        return False


def _check_whole(path: Path) -> None:
    """Raises InputError: the latest messages of a database are in SQLite's log beside it, which rosbags passes over."""
    for database in path.glob("*.db3") if path.is_dir() else (path,):
        beside = Path(f"{database}-wal")
        if beside.is_file() and beside.stat().st_size:
            raise InputError(
                f"the latest messages of '{database}' are still in '{beside.name}' beside it, as a killed recorder "
                f"leaves them: put them in with sqlite3 '{database}' 'PRAGMA wal_checkpoint'"
            )


def _readers(path: Path, alone: bool) -> Iterator[Reader]:
    """The readers of a bag; of a folder's files each alone if that is wanted, or there is no metadata."""
    if not path.is_dir():
        yield rosbag1.Reader(path) if _is_ros1(path) else rosbag2.Reader(path)
    elif (path / "metadata.yaml").is_file() and not alone:
        yield rosbag2.Reader(path)
    else:
        files = natsorted(child for child in path.iterdir() if child.suffix in (".db3", ".mcap"))
        if not files:
            raise FileNotFoundError("there is no metadata.yaml, .db3 or .mcap in it")
        yield from map(rosbag2.Reader, files)

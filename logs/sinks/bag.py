"""A ROS 1 bag to write."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO, cast

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer

from logs.sinks.output import OutputFile

_PADDING_AT = 86  # where the bag's header says how many spaces follow it
_PADDING = 4027  # as ROS has it; rosbags leaves 8 out, and `rosbag reindex` then writes over the first chunk


class _Opened:
    """Stands for the path of a file that is open, which rosbags opens and closes."""

    def __init__(self, file: BinaryIO) -> None:
        self.write, self.seek, self.tell = file.write, file.seek, file.tell

    def open(self, mode: str) -> _Opened:
        return self

    def close(self) -> None:
        pass


class BagOutput(OutputFile):
    """A ROS 1 bag whose chunks are closed by the clock: when the process is killed, `rosbag reindex` makes a whole bag
    of it, without the last second.

    Arguments and errors are those of `OutputFile`.
    """

    def __init__(self, path: Path, overwrite: bool) -> None:
        super().__init__(path, overwrite)
        self._writer = Writer(Path(os.devnull, "bag"))  # a place where no file can be, which is what it asks for
        self._writer.path = cast(Path, _Opened(self.file))
        with self.writing() as file:
            self._writer.open()
            self._pad()
            file.seek(_PADDING_AT + 4)
            file.write(b" " * _PADDING)
            file.flush()

    def connection(self, topic: str, message_type: str, definition: str, digest: str) -> Connection:
        """Announce a topic; returns what to write its messages with."""
        with self.writing():
            return self._writer.add_connection(topic, message_type, msgdef=definition, md5sum=digest)

    def write(self, connection: Connection, stamp_ns: int, data: bytes) -> None:
        """Add a message that players send at its stamp, ns."""
        with self.writing():
            self._writer.write(connection, stamp_ns, data)

    def flush_when_due(self) -> None:
        """Close the chunk when the last one was closed a second ago; call it when a frame is complete."""
        chunk = self._writer.chunks[-1]
        if chunk.connections and self.flush_is_due():  # ROS takes a chunk without messages for one of 1970
            with self.writing() as file:
                self._writer.write_chunk(chunk)
                file.flush()

    def close(self) -> None:
        """Write the index and close the file; safe to call twice."""
        if self.is_open:
            with self.writing():
                self._writer.close()
                self._pad()
            super().close()

    def _pad(self) -> None:
        self.file.seek(_PADDING_AT)
        self.file.write(_PADDING.to_bytes(4, "little"))

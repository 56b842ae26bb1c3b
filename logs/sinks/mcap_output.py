"""An MCAP file that grows: whatever was written a second ago can be read, however the process ends."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from mcap.writer import Writer

from airline.errors import InputError
from logs.sinks.output import FLUSH_S, OutputFile


class McapOutput:
    """Messages into an MCAP file, in chunks that are closed by the clock.

    Args:
        path: the file.
        metadata: of the file; written first, so that a cut file has it too.
        profile: MCAP's name for the kind of system the messages are from, such as "ros1".
        overwrite: whether an existing file is replaced.

    Raises:
        InputError: the file cannot be written; what was written before stays readable.
    """

    def __init__(
        self, path: Path, metadata: Mapping[str, Mapping[str, str]], *, profile: str = "", overwrite: bool = False
    ) -> None:
        self._output = OutputFile(path, overwrite)
        self._writer = Writer(self._output.file)
        with self._output.writing():
            self._writer.start(profile=profile, library="airline-frontend")
            for name, entries in metadata.items():
                self._writer.add_metadata(name, dict(entries))
            self._writer.flush()
        self._flushed = time.monotonic()

    def channel(self, topic: str, encoding: str, schema_name: str, schema_encoding: str, schema: bytes) -> int:
        """Announce a topic; returns the number to write its messages with."""
        with self._output.writing():
            schema_id = self._writer.register_schema(schema_name, schema_encoding, schema)
            return self._writer.register_channel(topic, encoding, schema_id)

    def write(self, channel: int, stamp_ns: int, data: bytes) -> None:
        """Add a message; players order and show messages by the stamp, ns."""
        if not 0 <= stamp_ns < 2**63:
            raise InputError(f"cannot write '{self._output.path}': MCAP has no time {stamp_ns} ns, before the epoch")
        with self._output.writing():
            self._writer.add_message(channel, stamp_ns, data, stamp_ns)

    def flush_when_due(self) -> None:
        """Close the chunk when the last one was closed a second ago; call it when a frame is complete."""
        now = time.monotonic()
        if now - self._flushed >= FLUSH_S:
            with self._output.writing():
                self._writer.flush()
            self._flushed = now

    def close(self) -> None:
        """Write the index; safe to call twice."""
        if self._output.is_open:
            with self._output.writing():
                self._writer.finish()
            self._output.close()

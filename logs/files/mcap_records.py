"""Records of an MCAP file, found and read within bounds. Format: https://mcap.dev/spec"""

from __future__ import annotations

import io
import os
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Protocol, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from airline.errors import InputError
from logs.files.mcap_chunks import HEAD, DamageError

MAGIC = b"\x89MCAP0\r\n"
SMALL_LIMIT = 64 << 20
"""Schemas, channels, metadata and the like of more bytes are not read."""

_DEFINITIONS_LIMIT = 256 << 20
_LEAST_LENGTH = {
    Opcode.HEADER: 8,
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: 22,
    Opcode.CHUNK: 40,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.ATTACHMENT: 36,
    Opcode.METADATA: 8,
    Opcode.DATA_END: 4,
}


@dataclass(frozen=True, slots=True)
class Record:
    """Where a record lies: from `offset` its head, from `body` to `end` the rest."""

    opcode: int
    offset: int
    end: int

    @property
    def body(self) -> int:
        return self.offset + HEAD.size

    @property
    def length(self) -> int:
        return self.end - self.body


class RecordFile:
    """An MCAP file by place; `size` is its length in bytes when it was opened.

    Raises:
        InputError: the file cannot be opened or is no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._file = open_binary(path)
        except (OSError, ValueError) as error:
            raise InputError(f"cannot open the log '{path}': {error}") from error
        self.size = os.fstat(self._file.fileno()).st_size
        try:
            magic = bytes(self.read(0, len(MAGIC)))
        except DamageError:
            magic = b""
        if magic != MAGIC:
            self.close()
            raise InputError(f"'{path}' is not an MCAP file")

    def read(self, offset: int, length: int) -> memoryview:
        """Bytes of the file; raises DamageError where there are not so many or the disk fails."""
        if not 0 <= offset <= self.size - length:
            raise DamageError("cut off record", misplaced=True)
        try:
            self._file.seek(offset)
            data = self._file.read(length)
        except (OSError, MemoryError) as error:
            raise DamageError("unreadable part of the disk") from error
        if len(data) != length:
            raise DamageError("cut off record", misplaced=True)
        return memoryview(data)

    def record(self, offset: int) -> Record | None:
        """The record at a place, if there can be one; it may end beyond the end of the file."""
        try:
            opcode, length = HEAD.unpack(self.read(offset, HEAD.size))
        except DamageError:
            return None
        if not opcode or length < _LEAST_LENGTH.get(opcode, 0):
            return None
        return Record(opcode, offset, offset + HEAD.size + length)

    def body(self, record: Record, limit: int = SMALL_LIMIT) -> memoryview:
        """What follows a record's head; raises DamageError."""
        if record.length > limit:
            raise DamageError("record of impossible size")
        return self.read(record.body, record.length)

    def close(self) -> None:
        """Release the file; safe to call twice."""
        self._file.close()


def open_binary(path: Path) -> BinaryIO:
    """The file, for reading."""
    return path.open("rb")


class _Readable(Protocol):
    @staticmethod
    def read(stream: ReadDataStream) -> object: ...


_T = TypeVar("_T")


class _StrictStream(ReadDataStream):
    """Where mcap's own stream returns less than was asked for, this one raises."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parse(kind: type[_T], body: memoryview) -> _T:
    """A small record of one of mcap's classes; raises DamageError."""
    if len(body) > SMALL_LIMIT:
        raise DamageError("record of impossible size")
    try:
        record: _T = kind.read(_StrictStream(io.BytesIO(body)))  # type: ignore[attr-defined]
    except (McapError, struct.error, ValueError) as error:
        raise DamageError("damaged record") from error
    return record


@dataclass
class Definitions:
    """Schemas and channels by id; the first of an id counts, as there must not be another."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    _bytes: int = 0

    def add(self, opcode: int, body: memoryview) -> Schema | Channel | None:
        """Take up a schema or channel; None if it is damaged, contradicts an earlier one, or is one too many."""
        try:
            if opcode == Opcode.SCHEMA:
                schema = parse(Schema, body)
                self._bytes += len(body) if schema.id not in self.schemas else 0
                fits = schema.id and self._bytes <= _DEFINITIONS_LIMIT
                return schema if fits and self.schemas.setdefault(schema.id, schema) == schema else None
            channel = parse(Channel, body)
        except DamageError:
            return None
        self._bytes += len(body) if channel.id not in self.channels else 0
        fits = self._bytes <= _DEFINITIONS_LIMIT
        return channel if fits and self.channels.setdefault(channel.id, channel) == channel else None

    def defines(self, channel_id: int) -> bool:
        """Whether a channel is known, and with it the schema that it names."""
        channel = self.channels.get(channel_id)
        return channel is not None and (not channel.schema_id or channel.schema_id in self.schemas)

"""ROS 1 bags without an index, as a recorder that was killed leaves them. Format: http://wiki.ros.org/Bags/Format/2.0

Their records are handed to the reader of MCAP files as if they were in one: connections are channels with schemas.
"""

from __future__ import annotations

import bz2
import struct
from typing import Any

import lz4.frame
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.summary import Summary

from logs.files.mcap_file import McapFile
from logs.files.mcap_records import CHUNK_LIMIT, DamageError, RecordFile

BAG_MAGIC = b"#ROSBAG V2.0\n"

_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_KINDS = {_MESSAGE: Opcode.MESSAGE, _CHUNK: Opcode.CHUNK, _CONNECTION: Opcode.CHANNEL}
_HEADER_LIMIT = 1 << 20
_SIZE = struct.Struct("<I")
_PART = 1 << 20
_MOST_CONNECTIONS = 1 << 16  # that the schemas and channels of MCAP can count

Fields = dict[bytes, bytes]


class BagRecords(RecordFile):
    """The records of a bag by place, as those of an MCAP file; a record or chunk that is cut ends with the file."""

    magic, named = BAG_MAGIC, "ROS 1 bag"

    def head(self, place: int) -> tuple[int, int]:
        """As in `RecordFile`; what has no counterpart is metadata. A chunk that was never closed is passed into."""
        fields, begin, end = self._record(place)
        kind = _KINDS.get(fields.get(b"op", b"\0")[0], Opcode.METADATA)
        if kind == Opcode.CHUNK:
            if end == begin or (end > self.size and fields.get(b"compression") == b"none"):
                return Opcode.METADATA, begin
            return kind, min(end, self.size)
        if end > self.size:
            raise DamageError("damaged record")
        return kind, end

    def chunk(self, begin: int, end: int) -> list[McapRecord]:
        fields, start, whole = self._record(begin)
        if fields.get(b"op") != bytes([_CHUNK]) or end != min(whole, self.size):
            raise DamageError("damaged record")
        data = _inflated(self._read(start, end - start), fields)
        return _records(data, whole=whole <= self.size)

    def run(self, begin: int, end: int) -> list[McapRecord]:
        return _records(self._read(begin, end - begin), whole=True)

    def summary(self) -> Summary | None:
        """There is none."""
        return None

    def _record(self, place: int) -> tuple[Fields, int, int]:
        """The header of a record, and where its data begin and end, perhaps behind the file's end."""
        (length,) = _SIZE.unpack(self._read(place, _SIZE.size))
        if length > _HEADER_LIMIT:
            raise DamageError("record of impossible size")
        begin = place + 2 * _SIZE.size + length
        head = self._read(place + _SIZE.size, length + _SIZE.size)
        return _fields(head[:length]), begin, begin + _SIZE.unpack(head[length:])[0]


class UnindexedBag(McapFile):
    """A ROS 1 bag, read through once when it is opened, up to damage that hides where the next record begins.

    Of a chunk that is cut all messages are read that are whole. Raises InputError: no such bag.
    """

    kind = "ROS 1 bag without an index"
    _records = BagRecords


def _fields(header: bytes) -> Fields:
    """The fields of a header, such as b"op"; raises DamageError."""
    fields, place = {}, 0
    while place < len(header):
        if place + _SIZE.size > len(header):
            raise DamageError("damaged record")
        (length,) = _SIZE.unpack_from(header, place)
        place += _SIZE.size + length
        name, equals, value = header[place - length : place].partition(b"=")
        if place > len(header) or not equals or not name:
            raise DamageError("damaged record")
        fields[name] = value
    if not fields.get(b"op"):
        raise DamageError("damaged record")
    return fields


def _records(data: bytes, whole: bool) -> list[McapRecord]:
    """The connections and messages in a chunk; up to its end if it is not whole, or raises DamageError."""
    found: list[McapRecord] = []
    place = 0
    try:
        while place < len(data):
            (length,) = _SIZE.unpack_from(data, place)
            begin = place + 2 * _SIZE.size + length
            (size,) = _SIZE.unpack_from(data, begin - _SIZE.size)
            if begin + size > len(data):
                raise DamageError("damaged chunk")
            found += _converted(_fields(data[place + _SIZE.size : begin - _SIZE.size]), data[begin : begin + size])
            place = begin + size
    except (DamageError, struct.error, KeyError, UnicodeDecodeError) as error:
        if whole:
            raise DamageError("damaged chunk") from error
    return found


def _converted(fields: Fields, data: bytes) -> list[McapRecord]:
    kind = fields[b"op"][0]
    if kind == _MESSAGE:
        seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
        time_ns = seconds * 10**9 + nanoseconds
        return [Message(_number(fields), time_ns, data, time_ns, 0)]
    if kind == _CONNECTION:
        number, inner = _number(fields), _fields(data + b"\4\0\0\0op=7")
        topic, name = fields[b"topic"].decode(), inner[b"type"].decode()
        # schemas count from 1
        return [Schema(number + 1, b"", "ros1msg", name), Channel(number, topic, "ros1", {}, number + 1)]
    return []


def _number(fields: Fields) -> int:
    (number,) = _SIZE.unpack(fields[b"conn"])
    if number >= _MOST_CONNECTIONS:
        raise DamageError("damaged record")
    return int(number)


def _inflated(stored: bytes, fields: Fields) -> bytes:
    """A chunk's records as far as they can be decompressed; raises DamageError."""
    if len(fields.get(b"size", b"")) != _SIZE.size:
        raise DamageError("damaged chunk")
    (size,) = _SIZE.unpack(fields[b"size"])
    if size > CHUNK_LIMIT:
        raise DamageError("chunk of impossible size")
    kind = fields.get(b"compression", b"")
    if kind == b"none":
        return stored
    if kind not in (b"lz4", b"bz2"):
        raise DamageError("chunk of unknown compression")
    reader: Any = lz4.frame.LZ4FrameDecompressor() if kind == b"lz4" else bz2.BZ2Decompressor()
    parts, length, given = [], 0, stored
    try:
        while length < size and not reader.eof:
            part = reader.decompress(given, max_length=min(_PART, size - length))
            if not part and reader.needs_input:
                break
            parts.append(part)
            length, given = length + len(part), b""
    except (RuntimeError, OSError, ValueError, EOFError, MemoryError) as error:
        raise DamageError("damaged chunk") from error
    return b"".join(parts)

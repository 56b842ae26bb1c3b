"""Chunks of MCAP files, decompressed and walked within bounds. Format: https://mcap.dev/spec

The `mcap` package believes what a chunk says about its size and copies every message of every channel out of it.
"""

from __future__ import annotations

import struct
import sys
import zlib
from array import array
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode

CHUNK_LIMIT = 1 << 30
"""Chunks and messages of more bytes are not read."""

HEAD = struct.Struct("<BQ")
"""Opcode of a record and the number of bytes that follow."""
MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message, its channel, sequence number, log time and publish time; its data follow."""

_CHUNK = struct.Struct("<QQQII")
# Bytes that one stored byte can become: an lz4 length byte stands for 255, and 4 bytes of zstd for a block of 128 KiB.
_MAX_RATIO = {"": 1, "lz4": 255, "zstd": 1 << 15}


class DamageError(Exception):
    """Something in the file cannot be read.

    Attributes:
        reason: what, the same words for the same fault, so that they can be counted.
        misplaced: there is no such record at all where one was expected, so that its end is not known either.
    """

    def __init__(self, reason: str, *, misplaced: bool = False) -> None:
        super().__init__(reason)
        self.reason = reason
        self.misplaced = misplaced


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk record as it is stored.

    Attributes:
        start_ns, end_ns: least and greatest log time, as claimed.
        size, crc: of the decompressed records, as claimed; a CRC of 0 stands for none.
        compression: "", "lz4" or "zstd".
        stored: the records, compressed.
    """

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    stored: memoryview


def parse_chunk(body: memoryview) -> Chunk:
    """A chunk record without its head; raises DamageError."""
    try:
        start_ns, end_ns, size, crc, name_length = _CHUNK.unpack_from(body)
        name = bytes(body[_CHUNK.size : _CHUNK.size + name_length])
        (stored_length,) = struct.unpack_from("<Q", body, _CHUNK.size + name_length)
    except struct.error as error:
        raise DamageError("damaged record", misplaced=True) from error
    stored = body[_CHUNK.size + name_length + 8 :]
    if len(stored) != stored_length:
        raise DamageError("damaged record", misplaced=True)
    compression = name.decode("ascii", "replace")
    if compression not in _MAX_RATIO:
        raise DamageError("chunk of unknown compression")
    return Chunk(start_ns, end_ns, size, crc, compression, stored)


def unpack(chunk: Chunk) -> memoryview:
    """The decompressed records; never allocates more than a possible claim says. Raises DamageError."""
    if chunk.size > CHUNK_LIMIT or chunk.size > len(chunk.stored) * _MAX_RATIO[chunk.compression]:
        raise DamageError("chunk of impossible size")
    try:
        data = _decompress(chunk)
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:  # RuntimeError is lz4's
        raise DamageError("damaged chunk") from error
    if len(data) != chunk.size or (chunk.crc and zlib.crc32(data) != chunk.crc):
        raise DamageError("damaged chunk")
    return memoryview(data)


def _decompress(chunk: Chunk) -> bytes | memoryview:
    if not chunk.compression or not chunk.size:
        return chunk.stored[: chunk.size]
    if chunk.compression == "lz4":
        decompressor = lz4.frame.LZ4FrameDecompressor()
        data: bytes = decompressor.decompress(chunk.stored, max_length=chunk.size)
        if not decompressor.eof:  # more would come
            raise DamageError("damaged chunk")
        return data
    # zstandard allocates what the frame says, where it says so, and not `max_output_size`
    if zstandard.frame_content_size(chunk.stored) not in (-1, chunk.size):
        raise DamageError("damaged chunk")
    return zstandard.ZstdDecompressor().decompress(chunk.stored, max_output_size=chunk.size)


def walk(data: memoryview) -> Iterator[tuple[int, int, int]]:
    """Opcode, place and end of every record, heads included.

    Raises:
        DamageError: where the next record makes no sense.
    """
    position, size, head = 0, len(data), HEAD.size
    while position + head <= size:
        opcode, length = HEAD.unpack_from(data, position)
        end = position + head + length
        if not opcode or end > size or (opcode == Opcode.MESSAGE and length < MESSAGE.size - head):
            break
        yield opcode, position, end
        position = end
    if position != size:
        raise DamageError("damaged chunk")


@dataclass(frozen=True, slots=True)
class Cut:
    """Messages of a chunk.

    Attributes:
        data: the chunk's decompressed records.
        times: log times, ns, ascending.
        positions: where in `data` the messages' records begin; ascending among equal times.
        whole: whether these are certainly all of the wanted channels.
    """

    data: memoryview
    times: array[int]
    positions: array[int]
    whole: bool


def cut(data: memoryview, channels: Collection[int]) -> Cut:
    """Messages of some channels, found by walking through all records."""
    times, positions = array("Q"), array("Q")
    whole = True
    try:
        for opcode, position, _ in walk(data):
            if opcode == Opcode.MESSAGE:
                _, _, channel, _, log_ns, _ = MESSAGE.unpack_from(data, position)
                if channel in channels:
                    times.append(log_ns)
                    positions.append(position)
    except DamageError:
        whole = False
    return _ordered(data, times, positions, whole)


def cut_by_index(data: memoryview, listed: dict[int, memoryview]) -> Cut | None:
    """Messages of some channels, found by the entries of their MessageIndex records; None if an entry does not hold."""
    times, positions = array("Q"), array("Q")
    for channel, entries in listed.items():
        pairs = array("Q", bytes(entries))
        if sys.byteorder == "big":
            pairs.byteswap()
        last = -1
        for log_ns, position in zip(pairs[::2], pairs[1::2], strict=True):
            if not last < position <= len(data) - MESSAGE.size:
                return None
            opcode, length, actual_channel, _, actual_ns, _ = MESSAGE.unpack_from(data, position)
            if (opcode, actual_channel, actual_ns) != (Opcode.MESSAGE, channel, log_ns):
                return None
            if not MESSAGE.size - HEAD.size <= length <= len(data) - HEAD.size - position:
                return None
            last = position
        times += pairs[::2]
        positions += pairs[1::2]
    return _ordered(data, times, positions, True)


def _ordered(data: memoryview, times: array[int], positions: array[int], whole: bool) -> Cut:
    columns = np.array(times), np.array(positions)
    if np.any(columns[0][1:] < columns[0][:-1]) or np.any(columns[1][1:] < columns[1][:-1]):
        order = np.lexsort(columns[::-1])
        times, positions = (array("Q", column[order].tobytes()) for column in columns)
    return Cut(data, times, positions, whole)

"""Records of an MCAP file, read and decompressed within bounds.

The `mcap` package believes what a record, a chunk or a zstd frame says about its size, lets lz4 make as much as it
likes, and follows a wrong footer into the data.
"""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary

from airline.errors import InputError
from logs.files import MCAP_MAGIC

CHUNK_LIMIT = 1 << 30
"""Chunks of more bytes, compressed or not, are not read."""

UNREADABLE = (McapError, struct.error, ValueError, OverflowError, MemoryError)
"""What the `mcap` package raises for damaged records."""

_SUMMARY_LIMIT = 64 << 20
_HEAD = struct.Struct("<BQ")  # opcode of a record, and the number of bytes that follow
_FOOTER = struct.Struct("<BQQQI8s")  # head, start of the summary, of its offsets, CRC; the magic
_BEFORE_CRC = struct.calcsize("<BQQQ")
_LEAST_MESSAGE = 22  # bytes
# Bytes that one stored byte can become: an lz4 length byte stands for 255, and 4 bytes of zstd for a block of 128 KiB.
_MAX_RATIO = {"": 1, "lz4": 255, "zstd": 1 << 15}


class DamageError(Exception):
    """A part of a file cannot be read; the message is the same for the same fault, so that faults can be counted."""


class _Within(ReadDataStream):
    """A record's part of the file, which is asked for no more than there is."""

    def __init__(self, file: BinaryIO, length: int) -> None:
        super().__init__(file)
        self._length = length

    def read(self, length: int) -> bytes:
        if length > self._length - self.count:
            raise EndOfFile
        return super().read(length)


class RecordFile:
    """An MCAP file by place; `size` is its length in bytes when it was opened, `begin` where the first record is.

    Raises:
        InputError: the file cannot be opened, or is no MCAP file.
    """

    magic, named = MCAP_MAGIC, "MCAP file"

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("rb")
            self.size = os.fstat(self._file.fileno()).st_size
            magic = self._file.read(len(self.magic))
        except (OSError, ValueError) as error:
            raise InputError(f"cannot open the log '{path}': {error}") from error
        self.begin = len(self.magic)
        if magic != self.magic:
            self.close()
            raise InputError(f"'{path}' is not an {self.named}")

    def head(self, place: int) -> tuple[int, int]:
        """Opcode and end of the record at a place; raises DamageError if there can be none."""
        opcode, length = _HEAD.unpack(self._read(place, _HEAD.size))
        end = place + _HEAD.size + length
        if not opcode or end > self.size or (opcode == Opcode.MESSAGE and length < _LEAST_MESSAGE):
            raise DamageError("damaged record")
        return opcode, end

    def chunk(self, begin: int, end: int) -> list[McapRecord]:
        """Schemas, channels and messages of a chunk; raises DamageError."""
        if self.head(begin) != (Opcode.CHUNK, end):
            raise DamageError("damaged record")
        if end - begin > CHUNK_LIMIT:
            raise DamageError("record of impossible size")
        try:
            self._file.seek(begin + _HEAD.size)
            chunk = Chunk.read(_Within(self._file, end - begin - _HEAD.size))
            data = _decompressed(chunk)
            if len(data) != chunk.uncompressed_size or not _is_filled(data):
                raise DamageError("damaged chunk")
            return breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)
        except (*UNREADABLE, OSError, zstandard.ZstdError, RuntimeError) as error:  # RuntimeError is lz4's
            raise DamageError("damaged chunk") from error

    def run(self, begin: int, end: int) -> list[McapRecord]:
        """Schemas, channels and messages outside chunks; raises DamageError."""
        data = self._read(begin, end - begin)
        try:
            return breakup_chunk(Chunk("", data, 0, 0, 0, len(data)))
        except UNREADABLE as error:
            raise DamageError("damaged record") from error

    def summary(self) -> Summary | None:
        """The summary at the file's end, None where it is missing or damaged."""
        place = self.size - _FOOTER.size
        try:
            footer = self._read(place, _FOOTER.size)
            _, _, start, _, crc, _ = _FOOTER.unpack(footer)
            if start < len(MCAP_MAGIC) or place - start > _SUMMARY_LIMIT:
                return None
            section = self._read(start, place - start)
            if crc and zlib.crc32(footer[:_BEFORE_CRC], zlib.crc32(section)) != crc:
                return None
            summary = Summary()
            for record in StreamReader(BytesIO(section + footer), skip_magic=True, emit_chunks=True).records:
                if isinstance(record, (Schema, Channel)):
                    define(summary, record)
                elif isinstance(record, Statistics):
                    summary.statistics = record
                elif isinstance(record, ChunkIndex):
                    summary.chunk_indexes.append(record)
        except (DamageError, *UNREADABLE):
            return None
        return summary

    def close(self) -> None:
        """Release the file; safe to call twice."""
        self._file.close()

    def _read(self, place: int, length: int) -> bytes:
        """Bytes of the file; raises DamageError where there are not so many, too many, or the disk fails."""
        if length > CHUNK_LIMIT:
            raise DamageError("record of impossible size")
        try:
            self._file.seek(place)
            data = self._file.read(length) if 0 <= length <= self.size - place else b""
        except (OSError, ValueError, OverflowError) as error:
            raise DamageError("unreadable part of the disk") from error
        if len(data) != length:
            raise DamageError("damaged record")
        return data


def _is_filled(data: bytes) -> bool:
    """Whether records fill a chunk to its end; `mcap` cuts the last one off there, and takes zeros for records."""
    place, opcode = 0, 1
    while opcode and place < len(data):
        opcode, length = _HEAD.unpack_from(data, place)
        place += _HEAD.size + length
    return place == len(data) and bool(opcode)


def define(summary: Summary, record: Schema | Channel) -> None:
    """Take up a definition; the first of an id counts, as there must not be another."""
    if isinstance(record, Schema):
        summary.schemas.setdefault(record.id, record)
    else:
        summary.channels.setdefault(record.id, record)


def _decompressed(chunk: Chunk) -> bytes:
    """The records of a chunk, other bytes or none if they are not as many as it says; raises DamageError."""
    if chunk.compression not in _MAX_RATIO:
        raise DamageError("chunk of unknown compression")
    size = chunk.uncompressed_size
    if size > min(CHUNK_LIMIT, len(chunk.data) * _MAX_RATIO[chunk.compression]):
        raise DamageError("chunk of impossible size")
    if chunk.compression == "lz4":
        decompressor = lz4.frame.LZ4FrameDecompressor()
        data: bytes = decompressor.decompress(chunk.data, max_length=size)
        return data if decompressor.eof else b""
    if chunk.compression == "zstd":
        # where the frame says a size, zstandard allocates that and not `max_output_size`
        says = zstandard.frame_content_size(chunk.data)
        return zstandard.decompress(chunk.data, max_output_size=size) if says in (-1, size) else b""
    return chunk.data

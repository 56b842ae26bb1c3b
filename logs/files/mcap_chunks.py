"""Chunks of MCAP files, decompressed within bounds.

The `mcap` package believes what a chunk or a zstd frame says about its size, and lets lz4 make as much as it likes.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from io import BytesIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import breakup_chunk

CHUNK_LIMIT = 1 << 30
"""Chunks of more bytes, compressed or not, are not read."""

UNREADABLE = (McapError, struct.error, ValueError, OverflowError, MemoryError)
"""What the `mcap` package raises for damaged records."""

# Bytes that one stored byte can become: an lz4 length byte stands for 255, and 4 bytes of zstd for a block of 128 KiB.
_MAX_RATIO = {"": 1, "lz4": 255, "zstd": 1 << 15}


class DamageError(Exception):
    """A part of a file cannot be read; the message is the same for the same fault, so that faults can be counted."""


def chunk_records(body: bytes) -> list[McapRecord]:
    """Schemas, channels and messages of a chunk record, which comes without its opcode and length.

    Raises:
        DamageError: one bit of it is wrong, where it has a CRC; or it claims a size that it cannot have.
    """
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        if chunk.compression not in _MAX_RATIO:
            raise DamageError("chunk of unknown compression")
        if chunk.uncompressed_size > min(CHUNK_LIMIT, len(chunk.data) * _MAX_RATIO[chunk.compression]):
            raise DamageError("chunk of impossible size")
        data = _decompressed(chunk)
        if len(data) != chunk.uncompressed_size:
            raise DamageError("damaged chunk")
        return breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)
    except (*UNREADABLE, zstandard.ZstdError, RuntimeError) as error:  # RuntimeError is lz4's
        raise DamageError("damaged chunk") from error


def _decompressed(chunk: Chunk) -> bytes:
    """The records, if they are not more than the chunk says."""
    if chunk.compression == "lz4":
        decompressor = lz4.frame.LZ4FrameDecompressor()
        data: bytes = decompressor.decompress(chunk.data, max_length=chunk.uncompressed_size)
        return data if decompressor.eof else b""
    if chunk.compression == "zstd":
        # where the frame says a size, zstandard allocates that and not `max_output_size`
        if zstandard.frame_content_size(chunk.data) not in (-1, chunk.uncompressed_size):
            return b""
        return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.uncompressed_size)
    return chunk.data

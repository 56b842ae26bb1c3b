"""Everything readable in an MCAP file, from front to back, whatever state the file is in."""

from __future__ import annotations

import re
import struct
from bisect import bisect_left
from collections.abc import Generator, Sequence
from dataclasses import dataclass

from mcap.opcode import Opcode

from logs.files.mcap_chunks import CHUNK_LIMIT, HEAD, Chunk, DamageError, parse_chunk, unpack
from logs.files.mcap_records import MAGIC, Record, RecordFile

_RUN_SIZE = 1 << 20
_IN_RUNS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_OPCODES = frozenset(Opcode)
_SEARCH_BLOCK = 1 << 20
_CHUNK_HEAD = re.compile(rb"\x06(?=.{4}\x00{4})", re.DOTALL)  # shorter than 4 GiB
_CHUNK_START = struct.Struct("<BQQQQII")


@dataclass(frozen=True, slots=True)
class Batch:
    """A chunk, or a run of schemas, channels and messages outside chunks, which look like an uncompressed chunk.

    Attributes:
        offset, end: its place in the file.
        chunk: as it is stored; None for a run.
        data: the records.
    """

    offset: int
    end: int
    chunk: Chunk | None
    data: memoryview


@dataclass(frozen=True, slots=True)
class Loss:
    """Something unreadable; `chunk` tells that it is a chunk whose MessageIndex records may follow."""

    offset: int
    reason: str
    chunk: bool = False


Part = Batch | Record | Loss


def scan(file: RecordFile, known_chunks: Sequence[int] = ()) -> Generator[Part, None, bool]:
    """Batches, places of all other records, and losses, in the order of the file; holds one batch at a time.

    After nonsense, goes on at the next chunk that has the right CRC or that is known.

    Args:
        known_chunks: places of chunks in ascending order, where an index tells them.

    Returns:
        Whether the file has its end: messages may lack behind the last part where it has not.
    """
    search = _Search(file, known_chunks)
    position: int | None = len(MAGIC)
    doubtful = len(MAGIC)  # from here on chunks may have been overlooked
    while position is not None and position < file.size:
        record = file.record(position)
        try:
            part = _part(file, position, record)
        except DamageError as error:
            if error.misplaced:
                found = search.next_chunk(doubtful, position)
                yield Loss(position, error.reason if found is None else "damaged record")
                position, doubtful = found, (found or 0) + 1
            else:
                assert record is not None  # else the error says misplaced
                yield Loss(position, error.reason, chunk=record.opcode == Opcode.CHUNK)
                position, doubtful = record.end, position + 1
            continue
        if part is None:
            return True
        yield part
        doubtful = part.end if isinstance(part, Batch) else position + 1
        position = part.end
    return False


def _part(file: RecordFile, position: int, record: Record | None) -> Batch | Record | None:
    """What lies at a place; None for the end of the data. Raises DamageError."""
    if record is None or record.end > file.size:
        raise DamageError("cut off record" if _is_cut(file, position, record) else "damaged record", misplaced=True)
    if record.opcode in (Opcode.DATA_END, Opcode.FOOTER):
        return None
    if record.opcode == Opcode.CHUNK:
        chunk = parse_chunk(file.body(record, 2 * CHUNK_LIMIT))
        return Batch(position, record.end, chunk, unpack(chunk))
    if record.opcode in _IN_RUNS:
        end = _run_end(file, record)
        return Batch(position, end, None, file.read(position, end - position))
    return record


def _is_cut(file: RecordFile, position: int, record: Record | None) -> bool:
    """Whether the end of the file, and not damage, may be why there is no whole record."""
    if record is None:
        return file.size - position < HEAD.size
    return record.opcode <= max(Opcode) and record.length <= 2 * CHUNK_LIMIT


def _run_end(file: RecordFile, first: Record) -> int:
    """Where a run of records outside chunks ends; without the last one if its length leads to nonsense."""
    if first.length > CHUNK_LIMIT:
        raise DamageError("record of impossible size")
    last, following = first, file.record(first.end)
    while following is not None and following.opcode in _IN_RUNS and following.end <= file.size:
        if following.end - first.offset > _RUN_SIZE:
            return last.end
        last, following = following, file.record(following.end)
    if file.size - last.end < HEAD.size or file.read(last.end, 1)[0] in _OPCODES:
        return last.end
    if last is first:
        raise DamageError("damaged record", misplaced=True)
    return last.offset


class _Search:
    """Finds the next chunk after nonsense.

    Bytes that only look like a chunk cost time, so that there is a limit to how many of them are looked into.
    """

    def __init__(self, file: RecordFile, known: Sequence[int]) -> None:
        self._file = file
        self._known = known
        self._budget = 4 * file.size + (256 << 20)

    def next_chunk(self, start: int, failed: int) -> int | None:
        """Place of the next known or sound chunk at `start` or later, but not at `failed`."""
        k = bisect_left(self._known, start)
        k += k < len(self._known) and self._known[k] == failed
        stop = self._known[k] if k < len(self._known) else self._file.size
        for block in range(start, stop, _SEARCH_BLOCK):
            try:
                length = min(_SEARCH_BLOCK + HEAD.size - 1, self._file.size - block)
                data = self._file.read(block, length)
            except DamageError:
                continue
            for match in _CHUNK_HEAD.finditer(data):
                if block + match.start() < stop and self._is_chunk(block + match.start()):
                    return block + match.start()
        return stop if k < len(self._known) else None

    def _is_chunk(self, offset: int) -> bool:
        record = self._file.record(offset)
        if record is None or record.end > self._file.size or self._budget <= 0:
            return False
        try:
            _, length, _, _, size, crc, name_length = _CHUNK_START.unpack(self._file.read(offset, _CHUNK_START.size))
            if not crc or name_length > 4 or size > CHUNK_LIMIT:
                return False
            self._budget -= length
            chunk = parse_chunk(self._file.body(record, 2 * CHUNK_LIMIT))
            self._budget -= size
            unpack(chunk)
        except DamageError:
            return False
        return True

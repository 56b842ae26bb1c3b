"""Files with tracks: which ones are ours, told from a few kilobytes of them, and what is in them.

Reading them is the business of `logs`, which this module loads on first use: the one place in `viz` that does.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

_PART = 1 << 16  # bytes that are read, at most
_MCAP = b"\x89MCAP0\r\n"
_PARQUET = b"PAR1"
_ARROW = b"\xff\xff\xff\xff"
_COLUMNS = (b"observed_x0", b"fragment_of", b"line_index", b"lost_segments")  # no other table has all of these


def kind_of(path: str | os.PathLike[str]) -> str | None:
    """Whether a file has tracks of ours, whatever its name: "mcap", "parquet" or "journal", or None.

    Reads 128 KB at most and imports nothing. A file of ours that is damaged elsewhere still counts as ours.
    """
    try:
        if not os.path.isfile(path):  # noqa: PTH113  pathlib raises for a name that is too long
            return None
        with open(path, "rb") as file:  # noqa: PTH123
            start = file.read(_PART)
            if start.startswith(_MCAP):
                return "mcap" if _is_our_mcap(file, start) else None
            if start.startswith(_PARQUET):
                return "parquet" if _is_our_parquet(file) else None
            if start.startswith(_ARROW):
                return "journal" if all(name in start for name in _COLUMNS) else None
    except (OSError, ValueError):
        return None
    return None


def _is_our_mcap(file: BinaryIO, start: bytes) -> bool:
    """By the metadata at its beginning; where another program has copied the messages, by the schemas at its end."""
    if b"airline-frontend" in start and b"topic of tracks" in start:
        return True
    file.seek(max(file.seek(0, os.SEEK_END) - _PART, 0))
    return b"frontend.LineTracks" in file.read(_PART)


def _is_our_parquet(file: BinaryIO) -> bool:
    """By the columns that the footer names first; a cut table has no footer, and nobody could tell whose it was."""
    size = file.seek(0, os.SEEK_END)
    if size < 12:
        return False
    file.seek(size - 8)
    length, magic = struct.unpack("<I4s", file.read(8))
    if magic != _PARQUET or length > size - 12:
        return False
    file.seek(size - 8 - length)
    footer = file.read(min(length, _PART))
    return all(name in footer for name in _COLUMNS)


def images_of(path: Path) -> Iterator[tuple[int, bytes]]:
    """Stamps, ns, and encoded images of the log with tracks; nothing for other files and logs without images."""
    if kind_of(path) != "mcap":
        return
    from logs.files.mcap_file import McapFile
    from logs.messages.registry import is_image_type, reader_for
    from logs.messages.types import EncodedImage, UndecodableError

    file = McapFile(path)
    try:
        for name, topic in file.topics.items():
            read = reader_for(topic.type.schema_name, topic.type.encoding)
            if read is None or not is_image_type(topic.type.schema_name):
                continue
            for message in file.messages(name):
                try:
                    record = read(message.data)
                except UndecodableError:  # that frame goes without
                    continue
                if isinstance(record, EncodedImage):
                    yield record.stamp_ns, bytes(record.data)
            return
    finally:
        file.close()

"""Raw Motion JPEG, which is one JPEG after the other, told from a still (ITU-T T.81, annex B)."""

from __future__ import annotations

import re
import struct

JPEG = b"\xff\xd8\xff"
_BEHIND_SCAN = re.compile(rb"\xff([\x01-\xcf\xd8-\xfe])")  # a marker behind a JPEG's pixels
_NEXT = re.compile(rb"[\0\r\n]*\xff\xd8\xff")
_END, _BEGIN, _SCAN, _FILL, _APP2 = 0xD9, 0xD8, 0xDA, 0xFF, 0xE2


def is_motion_jpeg(data: bytes | bytearray) -> bool | None:
    """Whether JPEGs of one size follow each other; None where the data end before they tell.

    A picture with another one that belongs to it, such as a stereo pair (MPO) or a preview, is a still.
    """
    if not data.startswith(JPEG):
        return False
    try:
        size, scan = _head(data, 0)
        following = _NEXT.match(data, _end(data, scan)) if scan else None
        return following is not None and size == _head(data, following.end() - len(JPEG))[0]
    except struct.error:
        return None


def _head(data: bytes | bytearray, place: int) -> tuple[bytes, int]:
    """Size of a JPEG, as coded, and where its pixels begin; 0 where others belong to it, or it is damaged.

    Raises:
        struct.error: the data end before.
    """
    size = b""
    place += 2
    while True:
        mark, marker, length = struct.unpack_from(">BBH", data, place)
        if mark != 0xFF or (marker == _APP2 and data[place + 4 : place + 8] == b"MPF\0"):
            return size, 0
        if marker == _FILL:
            place += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            size = bytes(data[place + 5 : place + 9])
        place += 2 + length
        if marker == _SCAN:
            return size, place


def _end(data: bytes | bytearray, place: int) -> int:
    """Where a JPEG ends whose pixels begin at a place; raises struct.error where the data end before."""
    while found := _BEHIND_SCAN.search(data, place):
        marker = found[1][0]
        if marker in (_END, _BEGIN):
            place = found.end() if marker == _END else found.start()
            if len(data) < place + len(JPEG):
                break
            return place
        place = found.start() + 2 + struct.unpack_from(">H", data, found.end())[0]  # of a progressive one
    raise struct.error

"""HEIC and AVIF files: what their boxes (ISO/IEC 23008-12) say of the picture, and HEIC's pixels by libheif."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airline.errors import from_extra
from frontend.sources.orientation import INVERSE, upright
from frontend.sources.reading import Bytes, UndecodableError

_AVIF = {b"avif", b"avis"}
_HEIC = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}
_TURNS = {0: 1, 1: 8, 2: 3, 3: 6}  # quarters counterclockwise to EXIF
_MIRRORED = {0: {1: 4, 3: 2, 6: 7, 8: 5}, 1: {1: 2, 3: 4, 6: 5, 8: 7}}  # by the axis, after the turn


def brand_of(head: bytes) -> str | None:
    """ "AVIF" or "HEIC" by a file's first bytes; None for another file, such as a video."""
    if head[4:8] != b"ftyp":
        return None
    (length,) = struct.unpack_from(">I", head)
    brands = {head[place : place + 4] for place in (8, *range(16, min(length, len(head)), 4))}
    return "AVIF" if brands & _AVIF else "HEIC" if brands & _HEIC else None


def shape_of(data: Bytes) -> tuple[int, int, int]:
    """Width and height in px of the largest picture, as stored, and the EXIF orientation of the main one.

    Raises:
        struct.error, KeyError: it is cut or damaged.
    """
    meta = {kind: (place, end) for kind, place, end in _boxes(data, 0, len(data))}[b"meta"]
    found = {kind: (place, end) for kind, place, end in _boxes(data, meta[0] + 4, meta[1])}
    properties = {kind: (place, end) for kind, place, end in _boxes(data, *found[b"iprp"])}
    listed = list(_boxes(data, *properties[b"ipco"]))
    sides = [struct.unpack_from(">II", data, place + 4) for kind, place, _ in listed if kind == b"ispe"]
    width, height = max(sides, key=lambda side: side[0] * side[1], default=(0, 0))
    exif = 1
    for number in _of_main(data, found[b"pitm"][0], properties[b"ipma"][0]):
        if not 1 <= number <= len(listed):
            continue
        kind, place, _ = listed[number - 1]
        if kind == b"irot":
            exif = _TURNS[data[place] & 3]
        elif kind == b"imir":
            exif = _MIRRORED[data[place] & 1].get(exif, exif)
    return width, height, exif


def decode_heic(data: Bytes, exif: int) -> NDArray[Any]:
    """(H, W[, 3 or 4]) uint8 BGR, as stored.

    Raises:
        ConfigError: libheif is not installed.
        UndecodableError: the file is damaged.
    """
    with from_extra("heic"):
        import pillow_heif
    try:
        pixels = np.asarray(pillow_heif.open_heif(bytes(data), bgr_mode=True))  # upright
    except (ValueError, LookupError, EOFError, OSError, RuntimeError, SyntaxError) as error:
        raise UndecodableError("cut or damaged image", str(error)) from error
    return upright(pixels, INVERSE.get(exif, exif))


def _boxes(data: Bytes, place: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Kind, and begin and end of the content, of the boxes in a part of the file."""
    while place + 8 <= end:
        length, kind = struct.unpack_from(">I4s", data, place)
        head = 8
        if length == 1:
            (length,) = struct.unpack_from(">Q", data, place + 8)
            head = 16
        if length and length < head:
            raise struct.error("a box shorter than its head")
        stop = min(end, place + length) if length else end
        yield kind, place + head, stop
        place = stop


def _of_main(data: Bytes, pitm: int, ipma: int) -> list[int]:
    """The numbers, from 1, of the main picture's properties, in their order."""
    (main,) = struct.unpack_from(">H" if data[pitm] == 0 else ">I", data, pitm + 4)
    version, wide = data[ipma], data[ipma + 3] & 1
    (count,) = struct.unpack_from(">I", data, ipma + 4)
    place = ipma + 8
    for _ in range(count):
        code = ">HB" if version == 0 else ">IB"
        item, many = struct.unpack_from(code, data, place)
        place += struct.calcsize(code)
        if item == main:
            numbers = struct.unpack_from(f">{many}{'H' if wide else 'B'}", data, place)
            return [number & (0x7FFF if wide else 0x7F) for number in numbers]
        place += many * (1 + wide)
    return []

"""The directories of TIFF files, one for each page, as Pillow reads them: OpenCV decodes only the first."""

from __future__ import annotations

import struct
from io import BytesIO
from typing import NamedTuple

from PIL.ExifTags import Base
from PIL.TiffImagePlugin import ImageFileDirectory_v2

_BIG = 43  # what BigTIFF has for 42
_MASK, _REDUCED_OR_MASK = 2, 1 | 4
_MOST_DIRECTORIES = 1 << 16


class Page(NamedTuple):
    """Where its directory is, its size in px, its EXIF orientation, and whether its pixels are compressed."""

    place: int
    width: int
    height: int
    exif: int
    compressed: bool


def pages_of(file: BytesIO) -> tuple[Page, ...]:
    """Those with pictures, without thumbnails and masks."""
    head = file.getvalue()[:16]
    head = head if head[2] == _BIG else head[:8]
    pages, seen, place = list[Page](), set[int](), ImageFileDirectory_v2(head).next
    while place and place not in seen and len(seen) < _MOST_DIRECTORIES:
        seen.add(place)
        file.seek(place)
        directory = ImageFileDirectory_v2(head)
        directory.load(file)

        def number(tag: Base, default: int, directory: ImageFileDirectory_v2 = directory) -> int:
            value = directory.get(tag, default)
            return int(value[0] if isinstance(value, tuple) else value)

        if not number(Base.NewSubfileType, 0) & _REDUCED_OR_MASK and number(Base.SubfileType, 1) != _MASK:
            size, exif = (number(Base.ImageWidth, 0), number(Base.ImageLength, 0)), number(Base.Orientation, 1)
            pages.append(Page(place, *size, exif if 1 <= exif <= 8 else 1, number(Base.Compression, 1) != 1))
        place = directory.next
    return tuple(pages)


def put_first(file: BytesIO, page: Page) -> memoryview:
    """The file, made to begin with this page."""
    buffer = file.getbuffer()
    order, wide = "<" if buffer[0] == ord("I") else ">", _BIG in buffer[2:4]
    struct.pack_into(f"{order}{'Q' if wide else 'I'}", buffer, 8 if wide else 4, page.place)
    return buffer

"""The directories of a TIFF file (TIFF 6.0, BigTIFF), which EXIF data are, too."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from frontend.sources.reading import Bytes

WIDTH, HEIGHT, BITS, COMPRESSION, ORIENTATION, SAMPLES = 256, 257, 258, 259, 274, 277
_NEW_SUBFILE, _SUBFILE = 254, 255
_REDUCED_OR_MASK = 1 | 4
_MOST_DIRECTORIES = 1 << 16
_NUMBERS = {1: "B", 3: "H", 4: "I", 16: "Q"}  # types of whole numbers


@dataclass(frozen=True)
class Directory:
    """One of them: its place in the file, where the values of its tags are, and the next one's place, 0 for none."""

    place: int
    tags: dict[int, tuple[int, str]]
    next: int


class Tiff:
    """A file's or EXIF block's directories; raises struct.error where it is cut or none."""

    def __init__(self, data: Bytes) -> None:
        self._data = data
        self.order = {b"II": "<", b"MM": ">"}.get(bytes(data[:2]), "")
        (magic,) = struct.unpack_from(f"{self.order}H", data, 2)
        if not self.order or magic not in (42, 43):
            raise struct.error("no TIFF")
        self.wide = magic == 43
        self.first_at = 8 if self.wide else 4  # where the first directory's place is

    @property
    def first(self) -> int:
        return int(self._read("Q" if self.wide else "I", self.first_at))

    def directory(self, place: int) -> Directory:
        head, entry, field = (8, 20, "Q") if self.wide else (2, 12, "I")
        count = self._read("Q" if self.wide else "H", place)
        if count > 0xFFFF:
            raise struct.error("too many tags")
        tags = {}
        for at in range(place + head, place + head + count * entry, entry):
            tag, kind = struct.unpack_from(f"{self.order}HH", self._data, at)
            number = self._read(field, at + 4)
            code = _NUMBERS.get(kind)
            if code is not None and number:
                inside = struct.calcsize(code) * number <= struct.calcsize(field)
                value = at + 4 + struct.calcsize(field)
                tags[tag] = (value if inside else self._read(field, value)), code
        return Directory(place, tags, self._read(field, place + head + count * entry))

    def value(self, directory: Directory, tag: int, default: int) -> int:
        """The first number of a tag."""
        place, code = directory.tags.get(tag, (0, ""))
        return self._read(code, place) if code else default

    def pages(self) -> list[Directory]:
        """The directories of pictures, without thumbnails and masks."""
        found, seen, place = [], set[int](), self.first
        while place and place not in seen and len(seen) < _MOST_DIRECTORIES:
            seen.add(place)
            directory = self.directory(place)
            reduced = self.value(directory, _NEW_SUBFILE, 0) & _REDUCED_OR_MASK
            if not reduced and self.value(directory, _SUBFILE, 1) != 2:
                found.append(directory)
            place = directory.next
        return found

    def _read(self, code: str, place: int) -> int:
        return int(struct.unpack_from(self.order + code, self._data, place)[0])


def exif_orientation(block: Bytes) -> int:
    """The orientation that EXIF data state, 1 to 8; 1 where they state none or are damaged."""
    try:
        tiff = Tiff(block)
        stated = tiff.value(tiff.directory(tiff.first), ORIENTATION, 1)
    except struct.error:
        return 1
    return stated if 1 <= stated <= 8 else 1

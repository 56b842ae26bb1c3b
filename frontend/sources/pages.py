"""Several pictures in one file: the pages of a TIFF, and animated GIF, PNG and WebP files."""

from __future__ import annotations

import struct
from itertools import accumulate
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.sources.orientation import upright
from frontend.sources.reading import Image, UndecodableError
from frontend.sources.stills import MOST_PIXELS, Header, damaged, decode_page, frame_of, read_header, silence

_SHORTEST_NS = 10_000_001  # browsers, too, show pictures of up to 10 ms for 100 ms
_USUAL_NS = 100_000_000


class Pages:
    """The pictures of one file, read in order or from any one on.

    Attributes:
        kind: for people, what the file is.
        stamps_ns: of the pictures; the first has 0.
        notes: for people, where the times are guessed.
    """

    def __init__(self, data: bytes, header: Header, fps: float) -> None:
        self.header, self.notes = header, list[str]()
        count = header.pictures
        if header.pages:
            self.kind = f"TIFF of {count} pages"
            self.stamps_ns = [round(k * 1e9 / fps) for k in range(count)]
            self.notes.append(f"the file's {count} pages are numbered by {fps:g} frames/s: --fps gives another rate")
        else:
            self.kind = f"animated {header.codec} of {count} pictures"
            shown = [ns if ns >= _SHORTEST_NS else _USUAL_NS for ns in header.durations_ns]
            self.stamps_ns = [0, *accumulate(shown[:-1])]
            if shown != list(header.durations_ns):
                self.notes.append("pictures without a duration count for 100 ms, as browsers show them")
        self._data = memoryview(bytearray(data) if header.pages else data)
        self._ready: dict[int, NDArray[Any]] = {}  # of an animation

    def read(self, number: int, *, autorotate: bool) -> Image:
        """A picture, from 0; raises UndecodableError for a damaged or too large one."""
        if self.header.pages:
            return decode_page(self._data, self.header.pages[number], autorotate)
        if number not in self._ready:
            self._ready = self._decode_from(number)
        image = frame_of(self._ready.pop(number))
        return upright(image, self.header.exif) if autorotate else image

    def _decode_from(self, number: int) -> dict[int, NDArray[Any]]:
        """As many pictures from one on as are in a bound of memory: for each of them OpenCV decodes all before."""
        height, width = self._shape
        count = max(1, MOST_PIXELS // (height * width))
        try:
            with silence():
                done, found = cv2.imdecodeanimation(np.frombuffer(self._data, np.uint8), number, count)
        except cv2.error as error:
            raise damaged(str(error)) from error
        if not done or not found.frames:
            raise damaged("its pixels cannot be decoded")
        return dict(enumerate(cast("list[NDArray[Any]]", found.frames), number))

    @property
    def _shape(self) -> tuple[int, int]:
        """Height and width of an animation in px, which its header bounds."""
        if self.header.codec == "PNG":
            width, height = struct.unpack_from(">II", self._data, 16)
        elif self.header.codec == "GIF":
            width, height = struct.unpack_from("<HH", self._data, 6)
        else:
            sides = int.from_bytes(self._data[24:30], "little")
            width, height = (sides & 0xFFFFFF) + 1, (sides >> 24) + 1
        return height, width


def open_pages(path: Path, fps: float) -> Pages | None:
    """The pictures of a file that has several; None for another file."""
    try:
        data = path.read_bytes()
        header = read_header(data)
    except (OSError, UndecodableError):  # reading it will tell
        return None
    return Pages(data, header, fps) if header.pictures > 1 else None

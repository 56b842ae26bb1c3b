"""Several pictures in one file: the pages of a TIFF, and animated GIF, PNG, WebP and AVIF files."""

from __future__ import annotations

import logging
from contextlib import suppress
from io import BytesIO
from itertools import accumulate
from pathlib import Path

from PIL.ImageFile import ImageFile

from frontend.sources.orientation import turned
from frontend.sources.reading import Image, UndecodableError
from frontend.sources.stills import Header, check_size, decode_page, open_image, pixels_of, read_header, reading

log = logging.getLogger(__name__)

_LONGEST_UNSEEN_MS = 10  # browsers, too, show such pictures for 100 ms
_USUAL_MS = 100


class Pages:
    """The pictures of one file, read in order or from any one on.

    Attributes:
        kind: for people, what the file is.
        stamps_ns: of the pictures; the first has 0.
        notes: for people, where the times are guessed, or pictures are lost.
    """

    def __init__(self, data: bytes, header: Header, fps: float) -> None:
        self.header, self._file = header, BytesIO(data)
        count = header.pictures
        if header.pages:
            self.kind = f"TIFF of {count} pages"
            self.stamps_ns = [round(k * 1e9 / fps) for k in range(count)]
            self.notes = [f"the file's {count} pages are numbered by {fps:g} frames/s: --fps gives another rate"]
            return
        self.kind, self.notes = f"animated {header.codec} of {count} pictures", []
        self._image = open_image(header.codec, data)
        durations = list[float]()
        with suppress(UndecodableError), reading():  # Pillow tells a picture's duration with its pixels
            durations.extend(self._shown(number).info.get("duration", 0) for number in range(count))
        self._image = open_image(header.codec, data)  # whose size a picture may have changed
        if len(durations) < count:
            self.notes.append(f"the file is cut or damaged after {len(durations)} of its {count} pictures")
            log.warning(self.notes[0])
        shown = [ms if ms > _LONGEST_UNSEEN_MS else _USUAL_MS for ms in durations]
        if shown != durations:
            self.notes.append("pictures without a duration count for 100 ms, as browsers show them")
        self.stamps_ns = [0, *(round(ms * 1e6) for ms in accumulate(shown[:-1]))]

    def read(self, number: int, *, autorotate: bool) -> Image:
        """A picture, from 0; raises UndecodableError for a damaged or too large one."""
        if self.header.pages:
            return decode_page(self._file, self.header.pages[number], autorotate)
        with reading():
            image = pixels_of(self._shown(number))
        return turned(image, self.header.exif, autorotate, already=False)

    def _shown(self, number: int) -> ImageFile:
        self._image.seek(number + getattr(self._image, "default_image", False))  # which a PNG may have apart
        check_size(*self._image.size)
        self._image.load()
        return self._image


def open_pages(path: Path, fps: float) -> Pages | None:
    """The pictures of a file that has several; None for another file."""
    try:
        data = path.read_bytes()
        header = read_header(data)
    except (OSError, UndecodableError):  # reading it will tell
        return None
    return Pages(data, header, fps) if header.pictures > 1 else None
